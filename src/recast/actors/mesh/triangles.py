"""Textured triangles, as read from a file, and the files in its folder that it names."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.images import decode_image, rgba
from recast.core.names import member

Alpha = Literal["OPAQUE", "MASK", "BLEND"]
Wrap = Literal["REPEAT", "CLAMP", "MIRROR"]
REPEATED: tuple[Wrap, Wrap] = ("REPEAT", "REPEAT")

MOST_TRIANGLES = 3_000_000
_FARTHEST = 1e7  # of a vertex from the origin, in the file's unit
MOST_PIXELS = 1 << 26
"""Of a texture, as its header says."""
MOST_TEXTURES = 32
_KEPT_EDGE = 2048  # pixels: finer than a vehicle is sampled
_FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TGA", "TIFF")


@dataclass(frozen=True)
class MeshMaterial:
    """How the triangles of one part look.

    Attributes:
        factor: (4,) linear RGB and alpha by which texture and vertex colours are multiplied.
        texture: (H, W, 4) uint8 sRGB and alpha, first row on top; None if there is none.
        alpha: OPAQUE ignores alpha, MASK cuts out what is below `cutoff`, BLEND lets light through.
        cutoff: alpha below which a MASK is open.
        gloss: share of a clear coat's reflection that the surface has, 0 to 1.
        wrap: how the texture goes on beyond 0 and 1 along u and v.
        lit: whether light falls on it; else it shows its colour as it is.
    """

    factor: Array = field(default_factory=lambda: np.array([0.5, 0.5, 0.5, 1.0]))
    texture: NDArray[np.uint8] | None = None
    alpha: Alpha = "OPAQUE"
    cutoff: float = 0.5
    gloss: float = 0.0
    wrap: tuple[Wrap, Wrap] = REPEATED
    lit: bool = True


@dataclass(frozen=True)
class Glow:
    """Light that the triangles of one part emit, beside what they reflect.

    Attributes:
        factor: (3,) linear RGB by which the texture is multiplied.
        texture, wrap: see `MeshMaterial`.
        uv: (F, 3, 2) texture coordinates; None without a texture.
    """

    factor: Array
    texture: NDArray[np.uint8] | None = None
    uv: Array | None = None
    wrap: tuple[Wrap, Wrap] = REPEATED


@dataclass(frozen=True)
class Triangles:
    """Triangles of one material.

    Attributes:
        corners: (F, 3, 3) in the file's frame and unit.
        uv: (F, 3, 2) texture coordinates, (0, 0) the upper left corner; None if there are none.
        colours: (F, 3, 4) linear vertex colours and alpha; None if there are none.
        material: how they look.
        glow: light that they emit; None if they do not.
    """

    corners: Array
    uv: Array | None
    colours: Array | None
    material: MeshMaterial
    glow: Glow | None = None

    def __len__(self) -> int:
        return len(self.corners)


def checked(path: Path, parts: Sequence[Triangles]) -> list[Triangles]:
    """The parts that have triangles, once all their numbers are finite and in range.

    Raises:
        InputError: no triangles, or a vertex, a texture coordinate or a colour is out of range.
    """
    parts = [part for part in parts if len(part)]
    if not parts:
        raise InputError(path, "mesh", "holds no triangles", "export the mesh with its faces")
    for part in parts:
        values = {"vertices": part.corners, "texture coordinates": part.uv, "colours": part.colours}
        if part.glow is not None:
            values |= {"emission": part.glow.factor, "emission texture coordinates": part.glow.uv}
        for name, found in values.items():
            if found is not None and not np.all(np.abs(found) <= _FARTHEST):  # also NaN
                problem = f"are not all finite and within {_FARTHEST:g}"
                raise InputError(path, name, problem, "export the mesh again")
    return parts


def require_few(path: Path, triangles: int) -> None:
    """Refuse a mesh of too many triangles, before memory for them is taken.

    Raises:
        InputError: there are more than `MOST_TRIANGLES`.
    """
    if triangles > MOST_TRIANGLES:
        problem = f"has {triangles} triangles"
        raise InputError(path, "mesh", problem, f"reduce the mesh to at most {MOST_TRIANGLES}")


def named_file(path: Path, name: str, what: str) -> Path:
    """The file that a mesh file names; it lies in the mesh's folder or below it.

    Args:
        path: the mesh file.
        name: file name as it stands in the mesh file; OBJ from Windows has backslashes.
        what: member of the mesh file, for messages.

    Raises:
        InputError: the name leads out of the folder.
    """
    return member(path.parent, name.replace("\\", "/"), path, what)


def decoded(path: Path, data: bytes, what: str) -> NDArray[np.uint8]:
    """A texture, (H, W, 4) sRGB and alpha, averaged until no edge is above 2048 pixels.

    Raises:
        InputError: no whole picture of a known format, or one of more than `MOST_PIXELS`.
    """
    mend = f"use {', '.join(_FORMATS)}"
    image = Image.fromarray(rgba(decode_image(data, path, _FORMATS, MOST_PIXELS, what, mend)))
    return np.array(image.reduce(math.ceil(max(image.size) / _KEPT_EDGE)))
