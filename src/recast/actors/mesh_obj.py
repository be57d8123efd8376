"""Wavefront OBJ with its material libraries: triangles with their base colours.

After the format's description (Alias|Wavefront, Advanced Visualizer, appendix B1, 1995) and what
exporters make of it: colours behind the vertices, `d` or `Tr` for alpha, options before the name of
a texture, roughness as `Pr`. Colours count as sRGB, as in three.js.

`Tr` is transparency, and `d` wins over it. MeshLab and openMVS write opacity as `Tr`: so it is
taken if no material in use is opaque otherwise, and one has `Tr 1`, which nobody would see.
"""

from __future__ import annotations

import io
import os
import re
from array import array
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from recast.actors.mesh_gltf import (
    MOST_TEXTURES,
    REPEATED,
    Array,
    Glow,
    MeshMaterial,
    Triangles,
    Wrap,
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
_GREY = MeshMaterial()
_NONE = -1  # stands for a corner without texture coordinates
_OPTION_VALUE = re.compile(r"[-+.\deE]+|on|off|[rgbmlz]|sphere|cube_\w+")  # of a texture
_OPTION_VALUES = {"-s": 3, "-o": 3, "-t": 3, "-mm": 2}  # at most; others have one
_SHININESS = 1000.0  # largest exponent of a highlight (Ns)
_MAPS = ("map_kd", "map_d", "map_ke")
_MARK, _WIDE_MARKS = b"\xef\xbb\xbf", (b"\xff\xfe", b"\xfe\xff")  # of UTF-8, of UTF-16


@dataclass(frozen=True)
class _Picture:
    """A texture's file, and how it is laid on."""

    path: Path
    # scale, offset: (2,) of texture coordinates, upwards.
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    wrap: tuple[Wrap, Wrap] = REPEATED


@dataclass(frozen=True)
class _Entry:
    """A material as a library has it."""

    colour: Array = field(default_factory=lambda: _GREY.factor[:3])  # (3,) linear `Kd`
    # opacity, transparency: `d` and `Tr`; None if they are not given.
    opacity: float | None = None
    transparency: float | None = None
    gloss: float = 0.0
    emission: Array | None = None  # (3,) linear `Ke`; None if it is not given
    # textures by their statement in lower case.
    pictures: Mapping[str, _Picture] = field(default_factory=dict)

    def alpha(self, tr_is_opacity: bool) -> float:
        """Its opacity, 0 to 1."""
        if self.opacity is not None or self.transparency is None:
            return 1.0 if self.opacity is None else self.opacity
        return self.transparency if tr_is_opacity else 1 - self.transparency


def read_obj(path: Path) -> list[Triangles]:
    """The triangles of an OBJ, a part for each material; polygons become triangles.

    What has neither a material nor colours is grey.

    Raises:
        InputError: a line is broken, an index out of range, too large, or a material library or a
            texture that it names is missing or not in its folder.
    """
    points, more, uvs = array("d"), array("d"), array("d")
    widths: set[int] = set()
    polygons: dict[str, dict[int, array[int]]] = {}
    libraries: list[Path] = []
    using, triangles = "", 0
    for number, words, rest in _lines(path):
        try:
            match words[0]:
                case "v":
                    points.extend(_floats(words[1:4], 3))
                    more.extend(map(float, words[4:]))
                    widths.add(len(words) - 4)
                case "vt":
                    uvs.extend(_floats(words[1:3], 2))
                case "f":
                    triangles += max(0, len(words) - 3)
                    require_few(path, triangles)
                    corners = [_corner(word, len(points) // 3, len(uvs) // 2) for word in words[1:]]
                    same = polygons.setdefault(using, {}).setdefault(len(corners), array("q"))
                    for corner in corners:
                        same.extend(corner)
                case "usemtl":
                    using = rest
                case "mtllib":
                    libraries += _libraries(path, rest)
        except (ValueError, OverflowError) as error:
            raise _fault(path, number, words, error) from None
    entries: dict[str, _Entry] = {}
    for library in libraries:
        entries |= _parse_library(library)
    pictures = _decoded(path, entries.values())
    entries = {name: entry for name, entry in entries.items() if name in polygons}
    vertices = np.array(points).reshape(-1, 3)
    colours = _colours(np.array(more).reshape(len(vertices), -1)) if len(widths) == 1 else None
    uv = np.array(uvs).reshape(-1, 2)
    inverted = len(entries) == len(polygons) and _tr_is_opacity(entries.values())
    parts = []
    for name, by_size in polygons.items():
        faces = np.concatenate([_triangles(vertices, n, flat) for n, flat in by_size.items()])
        entry = entries.get(name)
        parts.append(_part(faces, vertices, colours, uv, entry, pictures, inverted))
    return checked(path, parts)


def _tr_is_opacity(entries: Iterable[_Entry]) -> bool:
    """Whether nothing is opaque if `Tr` is transparency, and something vanishes by it."""
    entries = list(entries)
    vanishing = [e for e in entries if e.opacity is None and e.transparency == 1]
    return bool(vanishing) and all(entry.alpha(False) < 1 for entry in entries)


def _colours(more: Array) -> Array | None:
    """(N, 4) linear colours of the numbers (N, K) behind the coordinates; None if those are none.

    They are r g b, r g b a, w r g b or w r g b a, from 0 to 1, to 255 or to 65535. The weight w is
    1 throughout.
    """
    count = more.shape[1]
    if count not in (3, 4, 5) or len(more) == 0:
        return None
    weighted = count > 3 and bool(np.all(more[:, 0] == 1))
    if count == 4 and np.all(np.isin(more[:, 3], (1, 255, 65535))):  # a throughout
        weighted = False
    rgba = more[:, 1:] if weighted else more[:, :4]
    if rgba.shape[1] == 3:
        return np.insert(_brightness(rgba, rgba), 3, 1.0, axis=1)
    alpha = _brightness(rgba[:, 3:], rgba[:, 3:], linear=True)
    return np.concatenate([_brightness(rgba[:, :3], rgba), alpha], axis=1)


def _brightness(values: Array, scale: Array, linear: bool = False) -> Array:
    """Values as shares of the largest that numbers such as `scale` can have; sRGB made linear."""
    most = scale.max()
    shares = np.clip(values / (1 if not most >= 2 else 255 if most <= 255 else 65535), 0, 1)
    return shares if linear else srgb_to_linear(shares)


def _triangles(vertices: Array, size: int, flat: array[int]) -> NDArray[np.int64]:
    """(F, 3, 2) corners of triangles of polygons that have `size` corners: fans, if convex."""
    if size < 3:
        return np.zeros((0, 3, 2), np.int64)
    corners = np.array(flat).reshape(-1, size, 2)
    second = np.arange(1, size - 1)
    fan = np.stack([np.zeros_like(second), second, second + 1], axis=1)
    if size == 3:
        return corners[:, fan].reshape(-1, 3, 2)
    places = vertices[corners[..., 0]]
    with np.errstate(invalid="ignore", over="ignore"):  # what is not finite is refused later
        spokes = places - places[:, :1]
        normal = np.cross(spokes, np.roll(spokes, -1, axis=1)).sum(axis=1, keepdims=True)
        edges = np.roll(places, -1, axis=1) - places
        turns = np.sum(np.cross(np.roll(edges, 1, axis=1), edges) * normal, axis=2)
        concave = np.any(turns < -1e-9 * np.sum(normal**2, axis=2), axis=1)
    found = [corners[~concave][:, fan].reshape(-1, 3, 2)]
    for polygon, place, across in zip(
        corners[concave], places[concave], normal[concave], strict=True
    ):
        flattened = np.delete(place, np.argmax(np.abs(across)), axis=1)
        found.append(polygon[_cut(flattened, fan)])
    return np.concatenate(found)


def _cut(outline: Array, fan: NDArray[np.int64]) -> NDArray[np.int64]:
    """(F, 3) corners of triangles inside of an outline (N, 2); the fan if it crosses itself."""
    polygon = shapely.Polygon(outline)
    if not polygon.is_valid:
        return fan
    cut = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
    number = {tuple(point): i for i, point in enumerate(outline.tolist())}
    return np.array([[number[point] for point in part.exterior.coords[:3]] for part in cut])


def files_of_obj(path: Path) -> list[Path]:
    """The material libraries that an OBJ names, and the textures that these name. Raises
    InputError: see `read_obj`."""
    found: list[Path] = []
    for _, words, rest in _lines(path):
        if words[0] == "mtllib":
            for library in _libraries(path, rest):
                found.append(library)
                for entry in _parse_library(library).values():
                    found += [picture.path for picture in entry.pictures.values()]
    return list(dict.fromkeys(found))


def _lines(path: Path) -> Iterator[tuple[int, list[str], str]]:
    """Number, words and what follows the first word, of lines that are neither empty nor comment.
    Raises InputError: see `files.read_bytes`."""
    data = files.read_bytes(path, _MOST_BYTES).removeprefix(_MARK)
    if data.startswith(_WIDE_MARKS):
        data = data.decode("utf-16", "replace").encode()
    data = data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    for number, line in enumerate(io.BytesIO(data), 1):
        try:
            text = line.decode().strip()
        except UnicodeDecodeError:
            text = line.decode("latin-1").strip()
        if text and text[0] != "#":
            words = text.split()
            yield number, words, text[len(words[0]) :].strip()


def _libraries(path: Path, names: str) -> list[Path]:
    """Files that `mtllib` names: one, whose name may have blanks, or several that end in .mtl."""
    return [_named(path, name, "mtllib") for name in re.split(r"(?i)(?<=\.mtl)\s+", names)]


def _named(path: Path, name: str, what: str) -> Path:
    """The file of a name, maybe in quotes; on the disk the name may be in Latin-1."""
    name = name.strip('"')
    file = named_file(path, name, what)
    if not name.isascii() and not file.exists():
        with suppress(UnicodeEncodeError):
            other = named_file(path, os.fsdecode(name.encode("latin-1")), what)
            return other if other.exists() else file
    return file


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
        raise ValueError(
            f"corner {word} is not among {points} vertices and {uvs} texture coordinates"
        )
    return vertex, uv


def _index(number: int, count: int) -> int:
    return number + count if number < 0 else number - 1


def _part(
    faces: NDArray[np.int64],
    vertices: Array,
    colours: Array | None,
    uv: Array,
    entry: _Entry | None,
    pictures: Mapping[Path, NDArray[np.uint8]],
    tr_is_opacity: bool,
) -> Triangles:
    """Triangles of faces (F, 3, 2), vertex and texture coordinate of each corner.

    A texture stands in the place of `Kd`. A corner without texture coordinates has (0, 0), as
    OpenGL draws it.
    """
    vertex, coordinate = faces[..., 0], faces[..., 1]
    paints = None if colours is None else colours[vertex]

    def laid(picture: _Picture) -> Array:
        at = uv * picture.scale + picture.offset
        at = at * [1, -1] + [0, 1]  # the first row is on top here
        return np.concatenate([at, np.zeros((1, 2))])[coordinate]  # row _NONE

    if entry is None:
        material, placed, glow = _GREY if colours is None else MeshMaterial(np.ones(4)), None, None
    else:
        own = entry.pictures
        base, mask = own.get("map_kd"), own.get("map_d")
        alpha, texture = entry.alpha(tr_is_opacity), None if base is None else pictures[base.path]
        if mask is not None:
            texture = _masked(texture, pictures[mask.path])
        colour = entry.colour if base is None else np.ones(3)
        placed = base or mask
        material = MeshMaterial(
            np.append(colour, alpha),
            texture,
            "BLEND" if alpha < 1 or mask is not None else "OPAQUE",
            gloss=entry.gloss,
            wrap=REPEATED if placed is None else placed.wrap,
        )
        glow = _glow(entry, pictures)
        shining = own.get("map_ke")
        if glow is not None and shining is not None:
            glow = replace(glow, uv=laid(shining))
    if paints is not None and np.any(paints[..., 3] < 1):
        material = replace(material, alpha="BLEND")
    laid_on = None if placed is None else laid(placed)
    return Triangles(vertices[vertex], laid_on, paints, material, glow)


def _glow(entry: _Entry, pictures: Mapping[Path, NDArray[np.uint8]]) -> Glow | None:
    """What a material emits, without texture coordinates; None if it does not."""
    picture = entry.pictures.get("map_ke")
    factor = np.ones(3) if entry.emission is None and picture is not None else entry.emission
    if factor is None or not factor.any():
        return None
    if picture is None:
        return Glow(factor)
    return Glow(factor, pictures[picture.path], wrap=picture.wrap)


def _masked(texture: NDArray[np.uint8] | None, mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A texture (white without one) with the alpha of `map_d`: its alpha, or its brightness."""
    alpha = mask[..., 3] if mask[..., 3].min() < 255 else mask[..., :3].max(axis=2)
    if texture is None:
        texture = np.full((*alpha.shape, 4), 255, np.uint8)
    size = texture.shape[1::-1]
    return np.dstack([texture[..., :3], cv2.resize(alpha, size, interpolation=cv2.INTER_AREA)])


def _decoded(path: Path, entries: Iterable[_Entry]) -> dict[Path, NDArray[np.uint8]]:
    """Textures of materials, each once. Raises InputError: there are too many, or one is missing,
    too large or no picture."""
    named = {picture.path: statement for e in entries for statement, picture in e.pictures.items()}
    if len(named) > MOST_TEXTURES:
        problem = f"name {len(named)} textures"
        raise InputError(path, "materials", problem, f"use at most {MOST_TEXTURES} textures")
    return {
        one: decoded(path, files.read_bytes(one, _MOST_BYTES), f"{statement} {one.name}")
        for one, statement in named.items()
    }


def _parse_library(path: Path) -> dict[str, _Entry]:
    """Materials of a library by name."""
    found: dict[str, _Entry] = {}
    name = ""
    for number, words, rest in _lines(path):
        entry = found.get(name, _Entry())
        try:
            match words[0].lower():
                case "newmtl":
                    name, entry = rest, _Entry()
                case "kd":
                    entry = replace(entry, colour=srgb_to_linear(_shares(words[1:4], 3)))
                case "ke":
                    entry = replace(entry, emission=srgb_to_linear(_shares(words[1:4], 3)))
                case "d":
                    entry = replace(entry, opacity=float(_shares(words[-1:], 1)[0]))
                case "tr":
                    entry = replace(entry, transparency=float(_shares(words[-1:], 1)[0]))
                case "ns":
                    shine = _shares(words[1:2], 1, most=_SHININESS)
                    entry = replace(entry, gloss=float(np.sqrt(shine[0])))
                case "pr":
                    entry = replace(entry, gloss=1 - float(_shares(words[1:2], 1)[0]))
                case statement if statement in _MAPS:
                    picture = _picture(path, words[1:], f"line {number}")
                    entry = replace(entry, pictures={**entry.pictures, statement: picture})
        except ValueError as error:
            raise _fault(path, number, words, error) from None
        found[name] = entry
    return found


def _picture(path: Path, words: list[str], what: str) -> _Picture:
    """The file behind the options of a texture, whose name may hold blanks."""
    options: dict[str, list[str]] = {}
    while len(words) > 1 and words[0][0] == "-":
        option, words = words[0].lower(), words[1:]
        options[option] = []
        while (
            len(words) > 1
            and len(options[option]) < _OPTION_VALUES.get(option, 1)
            and _OPTION_VALUE.fullmatch(words[0])
        ):
            options[option].append(words[0])
            words = words[1:]

    def pair(option: str, usual: float) -> tuple[float, float]:
        u, v = ([float(word) for word in options.get(option, [])] + [usual] * 2)[:2]
        return u, v

    clamped = options.get("-clamp") == ["on"]
    wrap: tuple[Wrap, Wrap] = ("CLAMP", "CLAMP") if clamped else REPEATED
    file = _named(path, " ".join(words), what)
    return _Picture(file, pair("-s", 1.0), pair("-o", 0.0), wrap)
