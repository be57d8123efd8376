"""Wavefront OBJ with its material libraries: triangles with their base colours.

After the format's description (Alias|Wavefront, Advanced Visualizer, appendix B1, 1995) and what
exporters make of it: colours behind the vertices, `d` or `Tr` for alpha, options before the name of
a texture, roughness as `Pr`. Colours count as sRGB, as in three.js.
"""

from __future__ import annotations

import io
import re
from array import array
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast.actors.mesh.triangles import (
    MOST_TEXTURES,
    Alpha,
    Array,
    Material,
    Triangles,
    checked,
    decoded,
    named_file,
    require_few,
)
from recast.core import files
from recast.core.errors import InputError
from recast.geometry.colour import srgb_to_linear

_MOST_BYTES = 1 << 28
_MEND = "export it again, with its .mtl and textures in the same folder"
_GREY = Material()
_NONE = -1  # stands for a corner without texture coordinates
_OPTION_VALUE = re.compile(r"[-+.\deE]+|on|off|[rgbmlz]")  # of a texture: -s 1 1 1, -clamp on
_SHININESS = 1000.0  # largest exponent of a highlight (Ns)


def read_obj(path: Path) -> list[Triangles]:
    """The triangles of an OBJ, a part for each material; polygons become fans.

    What has neither a material nor colours is grey.

    Raises:
        InputError: a line is broken, an index out of range, too large, or a material library or a
            texture that it names is missing or not in its folder.
    """
    points, colours, uvs = array("d"), array("d"), array("d")
    corners: dict[str, array[int]] = {}
    libraries: list[Path] = []
    using, triangles = "", 0
    for number, words, rest in _lines(path):
        try:
            match words[0]:
                case "v":
                    points.extend(_floats(words[1:4], 3))
                    colours.extend(map(float, words[4:7] if len(words) == 7 else ()))
                case "vt":
                    uvs.extend(_floats(words[1:3], 2))
                case "f":
                    triangles += max(0, len(words) - 3)
                    require_few(path, triangles)
                    fan = [_corner(word, len(points) // 3, len(uvs) // 2) for word in words[1:]]
                    for second, third in pairwise(fan[1:]):
                        corners.setdefault(using, array("q")).extend((*fan[0], *second, *third))
                case "usemtl":
                    using = rest
                case "mtllib":
                    libraries.append(named_file(path, rest, "mtllib"))
        except (ValueError, OverflowError) as error:
            raise _fault(path, number, words, error) from None
    materials: dict[str, Material] = {}
    for library in libraries:
        materials |= _read_library(library)
    vertices = np.array(points).reshape(-1, 3)
    coloured = len(colours) == len(points) > 0
    paints = srgb_to_linear(np.clip(np.array(colours).reshape(-1, 3), 0, 1)) if coloured else None
    uv = np.array(uvs).reshape(-1, 2) * [1, -1] + [0, 1]  # the first row is on top here
    plain = Material(np.ones(4)) if coloured else _GREY
    parts = [
        _part(np.array(flat).reshape(-1, 3, 2), vertices, paints, uv, materials.get(name, plain))
        for name, flat in corners.items()
    ]
    return checked(path, parts)


def files_of_obj(path: Path) -> list[Path]:
    """The material libraries that an OBJ names, and the textures that these name.

    Raises:
        InputError: see `read_obj`.
    """
    found: list[Path] = []
    for _, words, rest in _lines(path):
        if words[0] == "mtllib":
            library = named_file(path, rest, "mtllib")
            found += [library, *(one for _, one in _parse_library(library).values() if one)]
    return list(dict.fromkeys(found))


def _lines(path: Path) -> Iterator[tuple[int, list[str], str]]:
    """Number, words and what follows the first word, of lines that are neither empty nor comment.

    Raises:
        InputError: see `files.read_bytes`.
    """
    data = files.read_bytes(path, _MOST_BYTES).replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    for number, line in enumerate(io.BytesIO(data), 1):
        text = line.decode(errors="surrogateescape").strip()
        if text and text[0] != "#":
            words = text.split()
            yield number, words, text[len(words[0]) :].strip()


def _floats(words: list[str], count: int) -> tuple[float, ...]:
    if len(words) != count:
        raise ValueError(f"{len(words)} numbers, {count} are needed")
    return tuple(map(float, words))


def _shares(words: list[str], count: int, most: float = 1.0) -> Array:
    """Numbers over the `most` that they can be, 0 to 1; what is beyond is cut off."""
    found = np.array(_floats(words, count)) / most
    if np.isnan(found).any():
        raise ValueError("is not a number")
    return np.clip(found, 0.0, 1.0)


def _fault(path: Path, number: int, words: list[str], error: Exception) -> InputError:
    if isinstance(error, InputError):
        return error
    return InputError(path, f"line {number}", f"{words[0]!r} cannot be read ({error})", _MEND)


def _corner(word: str, points: int, uvs: int) -> tuple[int, int]:
    """Vertex and texture coordinate of a corner, from 0; negative ones count from the last."""
    first, _, rest = word.partition("/")
    vertex = _index(int(first), points)
    uv = _index(int(rest.partition("/")[0] or 0), uvs)
    if not 0 <= vertex < points or not _NONE <= uv < uvs:
        raise ValueError(f"corner {word}, of {points} vertices and {uvs} texture coordinates")
    return vertex, uv


def _index(number: int, count: int) -> int:
    return number + count if number < 0 else number - 1


def _part(
    faces: NDArray[np.int64], vertices: Array, colours: Array | None, uv: Array, material: Material
) -> Triangles:
    """Triangles of faces (F, 3, 2), vertex and texture coordinate of each corner.

    A corner without texture coordinates has (0, 0), as OpenGL draws it.
    """
    vertex, coordinate = faces[..., 0], faces[..., 1]
    uv = np.concatenate([uv, np.zeros((1, 2))])  # row _NONE
    return Triangles(
        vertices[vertex],
        None if material.texture is None else uv[coordinate],
        None if colours is None else np.insert(colours[vertex], 3, 1.0, axis=2),
        material,
    )


def _read_library(path: Path) -> dict[str, Material]:
    """The materials of a library, textures decoded; a texture stands in the place of `Kd`.

    Raises:
        InputError: a line is broken, or a texture is missing, too large or no picture.
    """
    found = _parse_library(path)
    named = dict.fromkeys(picture for _, picture in found.values() if picture)
    if len(named) > MOST_TEXTURES:
        raise InputError(path, "map_Kd", f"names {len(named)} textures", f"{MOST_TEXTURES} at most")
    pictures = {
        one: decoded(path, files.read_bytes(one, _MOST_BYTES), f"map_Kd {one.name}")
        for one in named
    }
    return {
        name: replace(
            material,
            texture=pictures[picture],
            factor=np.append(np.ones(3), material.factor[3]),
        )
        if picture
        else material
        for name, (material, picture) in found.items()
    }


def _parse_library(path: Path) -> dict[str, tuple[Material, Path | None]]:
    """Materials of a library by name, and the texture of each."""
    found: dict[str, tuple[Material, Path | None]] = {}
    name = ""
    for number, words, rest in _lines(path):
        material, picture = found.get(name, (_GREY, None))
        factor = material.factor
        try:
            match words[0].lower():
                case "newmtl":
                    name = rest
                    found[name] = _GREY, None
                    continue
                case "kd":
                    factor = np.append(srgb_to_linear(_shares(words[1:4], 3)), factor[3])
                case "d":
                    factor = np.append(factor[:3], _shares(words[-1:], 1))
                case "tr":  # transparency: the same, the other way round
                    factor = np.append(factor[:3], 1 - _shares(words[-1:], 1))
                case "ns":
                    shine = _shares(words[1:2], 1, most=_SHININESS)
                    material = replace(material, gloss=float(np.sqrt(shine[0])))
                case "pr":
                    material = replace(material, gloss=1 - float(_shares(words[1:2], 1)[0]))
                case "map_kd":
                    picture = named_file(path, _picture(words[1:]), f"line {number}")
        except ValueError as error:
            raise _fault(path, number, words, error) from None
        alpha: Alpha = "BLEND" if factor[3] < 1 else "OPAQUE"
        found[name] = replace(material, factor=factor, alpha=alpha), picture
    return found


def _picture(words: list[str]) -> str:
    """The name behind the options of a texture, which may hold blanks."""
    while len(words) > 1 and words[0][0] == "-":
        words = words[1:]
        while len(words) > 1 and _OPTION_VALUE.fullmatch(words[0]):
            words = words[1:]
    return " ".join(words)
