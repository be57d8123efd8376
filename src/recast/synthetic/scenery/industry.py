"""What stands in yards: shipping containers and pallets."""

from __future__ import annotations

import numpy as np

from recast.synthetic.scenery.arguments import require_count, require_size
from recast.synthetic.scenery.panels import Panels
from recast.synthetic.scenery.primitives import at, boxes, lathe
from recast.synthetic.surface import Surface, concatenate

PAINTS = np.array(
    [
        (0.30, 0.06, 0.03),
        (0.03, 0.09, 0.26),
        (0.04, 0.16, 0.09),
        (0.42, 0.16, 0.02),
        (0.45, 0.45, 0.43),
        (0.20, 0.05, 0.04),
        (0.05, 0.22, 0.28),
        (0.16, 0.17, 0.18),
    ]
)
CONTAINER_WIDTH, CONTAINER_HEIGHT = 2.44, 2.59
RIB = 0.28
"""Metres from one rib of a container's walls to the next."""

PALLET_WOOD = np.array((0.33, 0.235, 0.14))
CARTON = np.array((0.36, 0.24, 0.13))
PALLET_HEIGHT = 0.144


def container(rng: np.random.Generator, length: float = 6.06) -> Surface:
    """A shipping container, x in [-length/2, length/2], y in [0, 2.44], doors at +x.

    Args:
        rng: chooses the paint and the lettering.
        length: metres, 2.5 to 16 (6.06 and 12.19 are the usual ones).

    Raises:
        InputError: for impossible lengths.
    """
    require_size("container", "length", length, 2.5, 16.0)
    half, w, h = length / 2, CONTAINER_WIDTH, CONTAINER_HEIGHT
    paint = PAINTS[rng.integers(len(PAINTS))] * rng.uniform(0.8, 1.2)
    panels = Panels()
    frame = 0.85 * paint
    for x in (-half, half - 0.14):
        for y in (0.0, w - 0.14):
            panels.box((x, y, 0.0), (x + 0.14, y + 0.14, h), frame, "plastic", "b")
            for z in (0.0, h - 0.12):
                block = (x - 0.004, y - 0.004, z), (x + 0.15, y + 0.15, z + 0.122)
                panels.box(*block, 0.6 * paint, "plastic")
    for y in (0.02, w - 0.12):
        panels.box((-half + 0.14, y, 0.02), (half - 0.14, y + 0.1, 0.18), frame, "plastic")
        panels.box((-half + 0.14, y, h - 0.1), (half - 0.14, y + 0.1, h - 0.01), frame, "plastic")
    panels.box(
        (-half + 0.05, 0.05, h - 0.06),
        (half - 0.05, w - 0.05, h - 0.02),
        paint,
        "corrugated",
        "bfklr",
    )
    _ribs(panels, half, 0.06, paint, front=True)
    _ribs(panels, half, w - 0.06, paint, front=False)
    panels.box(
        (-half + 0.06, 0.14, 0.1), (half - 0.08, w - 0.14, h - 0.08), paint, "corrugated", "btfk"
    )
    for y in np.array([0.35, 0.85, w - 0.89, w - 0.39]):
        panels.box(
            (half - 0.08, y, 0.12), (half - 0.03, y + 0.04, h - 0.12), (0.4, 0.4, 0.4), "metal"
        )
        panels.box(
            (half - 0.08, y - 0.04, 1.0), (half - 0.02, y + 0.22, 1.06), (0.4, 0.4, 0.4), "metal"
        )
    panels.box(
        (half - 0.09, w / 2 - 0.02, 0.1),
        (half - 0.07, w / 2 + 0.02, h - 0.1),
        0.2 * paint,
        "rubber",
    )
    _lettering(panels, rng, half, paint)
    return panels.surface()


def _ribs(panels: Panels, half: float, y: float, paint: np.ndarray, front: bool) -> None:
    """A side wall folded outwards and inwards, looking to -y or, when not front, to +y."""
    count = max(4, round((2 * half - 0.28) / RIB))
    edges = np.linspace(-half + 0.14, half - 0.14, count + 1)
    step = edges[1] - edges[0]
    inner = y + (0.045 if front else -0.045)
    for a in edges[:-1]:
        xs = a + step * np.array([0.0, 0.32, 0.5, 0.82, 1.0])
        ys = [y, y, inner, inner, y]
        for k in range(4):
            piece = [
                (xs[k], ys[k], 0.15),
                (xs[k + 1], ys[k + 1], 0.15),
                (xs[k + 1], ys[k + 1], CONTAINER_HEIGHT - 0.08),
                (xs[k], ys[k], CONTAINER_HEIGHT - 0.08),
            ]
            panels.polygon(piece if front else piece[::-1], paint, "plastic")


def _lettering(panels: Panels, rng: np.random.Generator, half: float, paint: np.ndarray) -> None:
    """An owner's name on the front as blocks, on two thirds of all."""
    if rng.random() < 0.33:
        return
    ink = (0.7, 0.7, 0.68) if paint.max() < 0.4 else (0.05, 0.06, 0.1)
    size = rng.uniform(0.5, 0.9)
    x = -half + 0.5
    for _ in range(int(rng.integers(3, 7))):
        wide = size * rng.uniform(0.45, 0.7)
        if x + wide > half - 0.4:
            break
        panels.rect(x, x + 0.3 * wide, 1.3, 1.3 + size, 0.052, ink, "plastic")
        bar = 1.3 + size * rng.choice([0.0, 0.4, 0.8])
        panels.rect(x + 0.3 * wide, x + wide, bar, bar + 0.2 * size, 0.052, ink, "plastic")
        if rng.random() < 0.5:
            panels.rect(x + 0.7 * wide, x + wide, 1.3, 1.3 + size, 0.052, ink, "plastic")
        x += wide + 0.2 * size


def pallets(rng: np.random.Generator, count: int | None = None) -> Surface:
    """A stack of wooden pallets, 1.2 m x 1.0 m about the origin; low stacks may carry goods.

    Args:
        rng: chooses goods and unevenness.
        count: pallets in the stack, 1 to 20; drawn when None.

    Raises:
        InputError: for impossible counts.
    """
    if count is None:
        count = int(rng.integers(1, 3)) if rng.random() < 0.6 else int(rng.integers(4, 12))
    require_count("pallets", "count", count, 1, 20)
    parts = []
    for k in range(count):
        shift = rng.normal(0, 0.015, 2) if k else np.zeros(2)
        parts.append(at(_pallet(rng), shift[0], shift[1], PALLET_HEIGHT * k, rng.normal(0, 0.02)))
    if count <= 2 and rng.random() < 0.8:
        parts.append(at(_goods(rng), 0.0, 0.0, PALLET_HEIGHT * count))
    return concatenate(parts)


def _pallet(rng: np.random.Generator) -> Surface:
    """Three skids under five boards."""
    tone = PALLET_WOOD * rng.uniform(0.7, 1.2)
    low = np.array([(-0.6, y, 0.0) for y in (-0.5, -0.05, 0.4)])
    skids = boxes(low, low + np.array([1.2, 0.1, 0.12]), 0.85 * tone, "wood", bottom=False)
    top = np.array([(x, -0.5, 0.12) for x in np.linspace(-0.6, 0.42, 5)])
    return concatenate(
        [
            skids,
            boxes(
                top,
                top + np.array([0.18, 1.0, 0.022]),
                tone * rng.uniform(0.85, 1.15, (5, 1)),
                "wood",
            ),
        ]
    )


def _goods(rng: np.random.Generator) -> Surface:
    """Cartons, drums, or a block in foil."""
    kind = rng.choice(["cartons", "drums", "foil"])
    if kind == "drums":
        paint = PAINTS[rng.integers(len(PAINTS))]
        drum = lathe(
            [
                (0.24, 0.0),
                (0.24, 0.3),
                (0.25, 0.31),
                (0.24, 0.32),
                (0.24, 0.84),
                (0.22, 0.86),
                (0.0, 0.86),
            ],
            12,
            paint,
            "plastic",
        )
        return concatenate([at(drum, x, y) for x in (-0.28, 0.28) for y in (-0.25, 0.25)])
    if kind == "foil":
        grey = rng.uniform(0.3, 0.6)
        return boxes(
            (-0.56, -0.46, 0),
            (0.56, 0.46, rng.uniform(0.8, 1.3)),
            (grey, grey, 1.03 * grey),
            "plastic",
        )
    layers = int(rng.integers(2, 5))
    low = np.array(
        [(x, y, 0.3 * z) for z in range(layers) for x in (-0.58, -0.19, 0.2) for y in (-0.48, 0.01)]
    )
    low = low[: len(low) - int(rng.integers(0, 4))]
    return boxes(
        low,
        low + np.array([0.37, 0.47, 0.295]),
        CARTON * rng.uniform(0.85, 1.15, (len(low), 1)),
        "matte",
    )
