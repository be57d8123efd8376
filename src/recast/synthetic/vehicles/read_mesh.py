"""A user's own mesh as a vehicle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.synthetic.materials import MATERIAL_INDEX
from recast.synthetic.surface import CREASE_ANGLE, Surface, corner_normals
from recast.synthetic.world import VehicleModel

Array = NDArray[np.float64]
FORMATS: tuple[str, ...] = ("glb", "gltf", "obj", "ply", "stl")
"""Extensions that can be read; all of them hold data only, no code is run."""

MOST_TRIANGLES = 500_000
SHORTEST, LONGEST = 0.2, 25.0
FARTHEST = 1e7
"""In the file's unit: what its arithmetic bears."""


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
        category: of the label, see `recast.logs.Track`.
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
        mend = f"give length; {SHORTEST} to {LONGEST} m a side"
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
        raise InputError(path, "mesh", "is not of triangles in space", "export it again")
    if faces.min() < 0 or faces.max() >= len(mesh.vertices):
        problem = f"names vertex {faces.max()} of {len(mesh.vertices)}"
        raise InputError(path, "faces", problem, "export it again")
    if not np.all(np.abs(mesh.vertices) <= FARTHEST):  # also NaN
        problem = f"are not all within {FARTHEST:g} of the origin"
        raise InputError(path, "vertices", problem, "export it again")
    colours = np.full((len(mesh.faces), 3), 0.4, np.float32)
    visual: Any = mesh.visual
    if visual.kind in ("face", "vertex"):
        colours = _linear(np.asarray(visual.face_colors)[:, :3] / 255.0)
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


def _linear(srgb: Array) -> NDArray[np.float32]:
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4).astype(
        np.float32
    )


def _axes(path: Path, up: str, forward: str) -> Array:
    rows = []
    for name, value in (("forward", forward), ("up", up)):
        axis = value.removeprefix("-")
        if axis not in ("x", "y", "z"):
            raise InputError(path, name, f"{value!r} is no axis", "use x, y, z, -x, -y or -z")
        rows.append(np.eye(3)["xyz".index(axis)] * (-1 if value.startswith("-") else 1))
    if abs(rows[0] @ rows[1]) > 0:
        raise InputError(path, "up", f"{up!r} is the axis of forward too", "use another axis")
    return np.stack([rows[0], np.cross(rows[1], rows[0]), rows[1]])
