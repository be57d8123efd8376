"""Other things than vehicles: furniture, signs and abstract shapes, for a general 3D prior."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from recast.errors import InputError
from recast.synthetic.surface import Surface, concatenate
from recast.synthetic.vehicles.finishes import CHROME
from recast.synthetic.vehicles.fittings import block, pebble
from recast.synthetic.vehicles.solid import Finish
from recast.synthetic.world import VehicleModel

_MATERIALS = ("matte", "plastic", "wood", "fabric", "paint", "metal")


def sample_shape(rng: np.random.Generator, name: str | None = None) -> VehicleModel:
    """A random shape: kind "shape-NAME", category "misc", every part closed, standing upright.

    Args:
        rng: source of all choices.
        name: one of `SHAPES`; None draws one.

    Raises:
        InputError: no such shape.
    """
    if name is None:
        name = SHAPES[int(rng.integers(len(SHAPES)))]
    if name not in _MAKERS:
        raise InputError("shape", "name", f"{name!r} is unknown", f"use {', '.join(SHAPES)}")
    surface = concatenate(_MAKERS[name](rng))
    low, high = surface.bounds()
    pose = np.eye(4)
    pose[:3, 3] = -(low + high) / 2
    return VehicleModel(f"shape-{name}", "misc", "mixed", high - low, surface.transformed(pose))


def _finish(rng: np.random.Generator) -> Finish:
    red, green, blue = (float(value) for value in rng.uniform(0.02, 0.8, 3))
    return Finish((red, green, blue), _MATERIALS[int(rng.integers(len(_MATERIALS)))])


def _legs(width: float, depth: float, height: float, thick: float, finish: Finish) -> list[Surface]:
    return [
        block(
            (x - thick / 2, y - thick / 2, 0.0), (x + thick / 2, y + thick / 2, height), finish
        ).surface()
        for x in (-depth / 2 + thick, depth / 2 - thick)
        for y in (-width / 2 + thick, width / 2 - thick)
    ]


def _chair(rng: np.random.Generator) -> list[Surface]:
    width, depth, seat = rng.uniform(0.4, 0.55, 3)
    back, finish = seat + rng.uniform(0.35, 0.6), _finish(rng)
    cushion = pebble((0, 0, seat), (depth, width, 0.07), _finish(rng), 5.0)
    rest = pebble((-depth / 2, 0, (seat + back) / 2), (0.06, width, back - seat), finish, 5.0)
    return [cushion.surface(), rest.surface(), *_legs(width, depth, seat, 0.04, finish)]


def _table(rng: np.random.Generator) -> list[Surface]:
    width, depth, height = rng.uniform((0.8, 0.6, 0.4), (2.0, 1.0, 0.8))
    finish = _finish(rng)
    plate = pebble((0, 0, height), (depth, width, 0.05), _finish(rng), float(rng.uniform(2, 8)))
    return [plate.surface(), *_legs(0.7 * width, 0.7 * depth, height, 0.06, finish)]


def _sofa(rng: np.random.Generator) -> list[Surface]:
    width, depth = float(rng.uniform(1.4, 2.4)), float(rng.uniform(0.8, 1.0))
    finish = Finish(_finish(rng).colour, "fabric")
    seat = pebble((0.05, 0, 0.25), (depth, width, 0.38), finish, 6.0)
    back = pebble((-depth / 2, 0, 0.45), (0.25, width, 0.8), finish, 5.0)
    arms = [pebble((0, y * width / 2, 0.35), (depth, 0.22, 0.6), finish, 4.0) for y in (-1, 1)]
    return [part.surface() for part in (seat, back, *arms)]


def _cabinet(rng: np.random.Generator) -> list[Surface]:
    width, depth, height = rng.uniform((0.5, 0.35, 0.7), (1.4, 0.6, 2.0))
    doors, finish = int(rng.integers(1, 4)), _finish(rng)
    parts = [block((-depth / 2, -width / 2, 0), (depth / 2, width / 2, height), _finish(rng))]
    for k in range(doors):
        low, high = (-width / 2 + width * (k + d) / doors for d in (0.04, 0.96))
        parts.append(block((depth / 2 - 0.01, low, 0.08), (depth / 2 + 0.02, high, height - 0.04),
                           finish))  # fmt: skip
        knob = (depth / 2 + 0.03, low + 0.06, height / 2)
        parts.append(pebble(knob, (0.04, 0.03, 0.15), CHROME, 4.0))
    return [part.surface() for part in parts]


def _sign(rng: np.random.Generator) -> list[Surface]:
    height, size = float(rng.uniform(2.0, 3.0)), float(rng.uniform(0.5, 1.0))
    plate = Finish(_finish(rng).colour, "sign")
    disc = pebble((0.05, 0, height), (0.03, size, size), plate, float(rng.uniform(2, 9)), (12, 16))
    post = block((-0.03, -0.03, 0), (0.03, 0.03, height), Finish((0.4, 0.4, 0.4), "metal"))
    return [disc.surface(), post.surface()]


def _vessel(rng: np.random.Generator) -> list[Surface]:
    """A turned body: bin, vase, bollard or cone."""
    radii = rng.uniform(0.12, 0.4, 5)
    height = float(rng.uniform(0.4, 1.2))
    rings, count = 14, 24
    up = np.linspace(0, 1, rings)
    radius = np.interp(up, np.linspace(0, 1, 5), radii)
    radius = np.convolve(np.pad(radius, 2, mode="edge"), np.ones(5) / 5, mode="valid")
    body = pebble((0, 0, 0), (2, 2, 2), _finish(rng), 2.0, (rings + 1, count))
    along = np.repeat(np.arange(rings), count)
    flat = np.linalg.norm(body.points[:-2, :2], axis=1, keepdims=True)
    body.points[:-2, :2] *= radius[::-1][along][:, None] / flat
    body.points[:-2, 2] = (up[::-1] * height)[along]
    body.points[-2:, 2] = height, 0.0
    return [Surface.make(body.points, body.faces, body.colours, "plastic")]


def _pile(rng: np.random.Generator) -> list[Surface]:
    """Abstract: rounded blocks on and beside each other."""
    parts = []
    for _ in range(int(rng.integers(3, 7))):
        size = rng.uniform(0.2, 0.8, 3)
        x, y, z = rng.uniform((-0.5, -0.5, 0.0), (0.5, 0.5, 1.0))
        parts.append(pebble((x, y, z), tuple(size), _finish(rng), float(rng.uniform(1.2, 8))))
    return [part.surface() for part in parts]


def _blob(rng: np.random.Generator) -> list[Surface]:
    """Abstract: a smooth bumpy body."""
    body = pebble((0, 0, 0), (1, 1, 1), _finish(rng), 2.0, (18, 28))
    bump = np.ones(len(body.points))
    for _ in range(5):
        wave = rng.normal(size=3) * 4
        bump += rng.uniform(0.03, 0.12) * np.sin(body.points @ wave + rng.uniform(0, 6))
    points = body.points * bump[:, None] * rng.uniform(0.5, 1.4, 3)
    return [Surface.make(points, body.faces, body.colours, "plastic", np.pi)]


_MAKERS: dict[str, Callable[[np.random.Generator], list[Surface]]] = {
    "chair": _chair, "table": _table, "sofa": _sofa, "cabinet": _cabinet, "sign": _sign,
    "vessel": _vessel, "pile": _pile, "blob": _blob,
}  # fmt: skip

SHAPES: tuple[str, ...] = tuple(_MAKERS)
"""All names that `sample_shape` knows."""
