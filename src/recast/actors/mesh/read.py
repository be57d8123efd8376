"""The readers of mesh files, by the end of their names."""

from __future__ import annotations

from pathlib import Path

from recast.actors.mesh.gltf import files_of_glb, read_glb
from recast.actors.mesh.obj import files_of_obj, read_obj
from recast.actors.mesh.triangles import Triangles
from recast.errors import InputError

_READERS = {".glb": (read_glb, files_of_glb), ".obj": (read_obj, files_of_obj)}
MESH_SUFFIXES = tuple(_READERS)
"""Ends of the names of files that can be read, in lower case."""


def read_triangles(path: Path) -> list[Triangles]:
    """The triangles of a mesh file, in its frame and unit.

    Raises:
        InputError: see `read_glb` and `read_obj`; or a file of another kind.
    """
    return _readers(path)[0](path)


def files_of_mesh(path: Path) -> list[Path]:
    """The file and all that it names: material libraries, textures, buffers.

    Raises:
        InputError: see `read_triangles`.
    """
    return [path, *_readers(path)[1](path)]


def _readers(path: Path) -> tuple:
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        known = ", ".join(MESH_SUFFIXES)
        raise InputError(path, "format", f"{suffix!r} is unknown", f"use {known}")
    return _READERS[suffix]
