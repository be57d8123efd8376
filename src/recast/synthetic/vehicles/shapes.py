"""Other things than vehicles, for a general 3D prior, and the reader of a user's own mesh."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array
from recast.core.errors import InputError
from recast.geometry.colour import srgb_to_linear
from recast.synthetic.surface import (
    CREASE_ANGLE,
    MATERIAL_INDEX,
    Surface,
    at,
    concatenate,
    corner_normals,
)
from recast.synthetic.vehicles.bodywork import block, pebble
from recast.synthetic.vehicles.solid import CHROME, Finish
from recast.synthetic.world import VehicleModel

_MATERIALS = ("matte", "plastic", "wood", "fabric", "paint", "metal")
FORMATS: tuple[str, ...] = ("glb", "gltf", "obj", "ply", "stl")
"""Extensions that can be read; all of them hold data only, no code is run."""

MOST_TRIANGLES = 500_000
SHORTEST, LONGEST = 0.2, 25.0
FARTHEST = 1e7
"""In the file's unit: what its arithmetic bears."""


def sample_shape(rng: np.random.Generator, name: str | None = None) -> VehicleModel:
    """A random shape: kind "shape-NAME", category "misc", every part closed, standing upright.

    Args:
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
    centred = at(surface, *-(low + high) / 2)
    return VehicleModel(f"shape-{name}", "misc", "mixed", high - low, centred)


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
        parts.append(
            block((depth / 2 - 0.01, low, 0.08), (depth / 2 + 0.02, high, height - 0.04), finish)
        )
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
    body.points[:-2, :2] *= radius[along][:, None] / flat
    body.points[:-2, 2] = (up * height)[along]
    body.points[-2:, 2] = 0.0, height
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
    "chair": _chair,
    "table": _table,
    "sofa": _sofa,
    "cabinet": _cabinet,
    "sign": _sign,
    "vessel": _vessel,
    "pile": _pile,
    "blob": _blob,
}

SHAPES: tuple[str, ...] = tuple(_MAKERS)
"""All names that `sample_shape` knows."""


def read_mesh(
    path: Path | str,
    kind: str = "custom",
    *,
    category: str = "car",
    up: str = "z",
    forward: str = "x",
    length: float | None = None,
    material: str = "paint",
) -> VehicleModel:
    """A closed mesh from a glTF, OBJ, PLY or STL file; the box fits it tightly.

    Args:
        path: the file.
        kind: name to give it.
        category: category of the label, see `recast.logs.Track`.
        up, forward: the file's axes, "x", "y", "z" or with a minus sign; glTF has "y" and "z".
        length: metres that it shall have; None takes the file's unit as metres.
        material: a name in `MATERIALS`, of all faces.

    Raises:
        InputError: no such file, another format, unreadable, empty, not watertight, an impossible
            size, or the same axis twice.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "mesh", "is not a file", "name a mesh file")
    suffix = path.suffix.lower().lstrip(".")
    if suffix not in FORMATS:
        raise InputError(path, "format", f"{suffix!r} is unknown", f"use {', '.join(FORMATS)}")
    if length is not None and not SHORTEST <= length <= LONGEST:
        problem = f"{length:g} m is impossible"
        raise InputError(path, "length", problem, f"use {SHORTEST} to {LONGEST} m")
    if material not in MATERIAL_INDEX:
        known = ", ".join(MATERIAL_INDEX)
        raise InputError(path, "material", f"{material!r} is unknown", f"use one of {known}")
    vertices, faces, colours = _load(path, suffix)
    vertices = vertices @ _axes(path, up, forward).T
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    if length is not None and high[0] > low[0]:
        vertices = vertices * (length / (high[0] - low[0]))
        low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = high - low
    if not (np.all(size >= SHORTEST) and np.all(size <= LONGEST)):
        shown = " x ".join(f"{value:.3g}" for value in size)
        mend = f"give a length, so that each side has {SHORTEST} to {LONGEST} m"
        raise InputError(path, "size", f"{shown} m is impossible", mend)
    vertices = vertices - (low + high) / 2
    surface = Surface(
        vertices,
        faces,
        corner_normals(vertices, faces, CREASE_ANGLE),
        colours,
        np.full(len(faces), MATERIAL_INDEX[material], np.uint8),
    )
    return VehicleModel(kind, category, "own", size, surface)


def _load(path: Path, suffix: str) -> tuple[Array, NDArray[np.int32], NDArray[np.float32]]:
    try:
        import trimesh
    except ImportError as error:
        raise InputError(
            "trimesh", "module", "is not installed", "pip install 'recast-sim[synthetic]'"
        ) from error
    try:
        with path.open("rb") as file:
            mesh: Any = trimesh.load(file, file_type=suffix, force="mesh", process=False)
    except Exception as error:
        # Every format's reader fails in its own way on garbage; the user needs one line.
        raise InputError(path, "mesh", "cannot be read as " + suffix, "export it again") from error
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise InputError(path, "mesh", "holds no triangles", "export it with its faces")
    if len(mesh.faces) > MOST_TRIANGLES:
        problem = f"has {len(mesh.faces)} triangles"
        raise InputError(path, "mesh", problem, f"reduce it to {MOST_TRIANGLES}")
    if len(mesh.vertices) > 3 * MOST_TRIANGLES:
        problem = f"has {len(mesh.vertices)} vertices"
        raise InputError(path, "mesh", problem, f"reduce it to {3 * MOST_TRIANGLES}")
    faces = np.asarray(mesh.faces)
    if faces.shape != (len(faces), 3) or mesh.vertices.shape != (len(mesh.vertices), 3):
        raise InputError(
            path, "mesh", "does not consist of triangles in three dimensions", "export it again"
        )
    if faces.min() < 0 or faces.max() >= len(mesh.vertices):
        problem = f"names vertex {faces.max()} of {len(mesh.vertices)}"
        raise InputError(path, "faces", problem, "export it again")
    if not np.all(np.abs(mesh.vertices) <= FARTHEST):  # also NaN
        problem = f"are not all within {FARTHEST:g} of the origin"
        raise InputError(path, "vertices", problem, "export it again")
    colours = np.full((len(mesh.faces), 3), 0.4, np.float32)
    visual: Any = mesh.visual
    if visual.kind in ("face", "vertex"):
        shown = np.asarray(visual.face_colors)[:, :3] / 255.0
        colours = srgb_to_linear(shown).astype(np.float32)
    # STL repeats the corners of every triangle, and texture seams split vertices: places alone
    # count. What else the file says of a vertex may be anything.
    mesh = trimesh.Trimesh(np.array(mesh.vertices, np.float64), faces, process=False)
    mesh.merge_vertices()
    if not mesh.is_watertight or not mesh.is_winding_consistent:
        raise InputError(
            path, "mesh", "is not watertight", "close its holes and merge its vertices"
        )
    if mesh.volume < 0:
        mesh.invert()
    return np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int32), colours


def _axes(path: Path, up: str, forward: str) -> Array:
    rows = []
    for name, value in (("forward", forward), ("up", up)):
        axis = value.removeprefix("-")
        if axis not in ("x", "y", "z"):
            raise InputError(path, name, f"{value!r} is not an axis", "use x, y, z, -x, -y or -z")
        rows.append(np.eye(3)["xyz".index(axis)] * (-1 if value.startswith("-") else 1))
    if abs(rows[0] @ rows[1]) > 0:
        raise InputError(path, "up", f"{up!r} is the axis of forward too", "use another axis")
    return np.stack([rows[0], np.cross(rows[1], rows[0]), rows[1]])
