"""Textured triangles, the files that a mesh names, and the reader of GLB."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.files import member
from recast.core.gltf_file import (
    FAN,
    STRIP,
    TRIANGLES,
    EmissiveStrength,
    GlbFile,
    Glossy,
    GltfTexture,
    Primitive,
    TextureTransform,
    TextureUse,
    Transmission,
    data_of,
    named_uri,
    placed_primitives,
)
from recast.core.images import decode_image, rgba
from recast.geometry import se3

Alpha = Literal["OPAQUE", "MASK", "BLEND"]
Wrap = Literal["REPEAT", "CLAMP", "MIRROR"]
REPEATED: tuple[Wrap, Wrap] = ("REPEAT", "REPEAT")

MOST_TRIANGLES = 3_000_000
_FARTHEST = 1e7  # of a vertex from the origin, in the file's unit
MOST_PIXELS = 1 << 26
"""Pixels of a texture, as its header says, at most."""
MOST_TEXTURES = 32
_KEPT_EDGE = 2048  # pixels: finer than a vehicle is sampled
_FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TGA", "TIFF")


@dataclass(frozen=True)
class MeshMaterial:
    """How the triangles of one part look."""

    # (4,) linear RGB and alpha by which texture and vertex colours are multiplied.
    factor: Array = field(default_factory=lambda: np.array([0.5, 0.5, 0.5, 1.0]))
    # (H, W, 4) uint8 sRGB and alpha, first row on top; None if there is none.
    texture: NDArray[np.uint8] | None = None
    # OPAQUE ignores alpha, MASK cuts out what is below `cutoff`, BLEND lets light through.
    alpha: Alpha = "OPAQUE"
    cutoff: float = 0.5  # alpha below which a MASK is open
    gloss: float = 0.0  # share of a clear coat's reflection that the surface has, 0 to 1
    wrap: tuple[Wrap, Wrap] = REPEATED  # how the texture goes on beyond 0 and 1 along u and v
    lit: bool = True  # whether light falls on it; else it shows its colour as it is


@dataclass(frozen=True)
class Glow:
    """Light that the triangles of one part emit, beside what they reflect."""

    factor: Array  # (3,) linear RGB by which the texture is multiplied
    # texture, wrap: see `MeshMaterial`.
    texture: NDArray[np.uint8] | None = None
    uv: Array | None = None  # (F, 3, 2) texture coordinates; None without a texture
    wrap: tuple[Wrap, Wrap] = REPEATED


@dataclass(frozen=True)
class Triangles:
    """Triangles of one material."""

    corners: Array  # (F, 3, 3) in the file's frame and unit
    # (F, 3, 2) texture coordinates, (0, 0) the upper left corner; None if there are none.
    uv: Array | None
    colours: Array | None  # (F, 3, 4) linear vertex colours and alpha; None if there are none
    material: MeshMaterial  # how they look
    glow: Glow | None = None  # light that they emit; None if they do not

    def __len__(self) -> int:
        return len(self.corners)


def checked(path: Path, parts: Sequence[Triangles]) -> list[Triangles]:
    """The parts that have triangles, once all their numbers are finite and in range. Raises
    InputError: no triangles, or a vertex, a texture coordinate or a colour is out of range."""
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
    """Refuse a mesh of too many triangles, before memory for them is taken. Raises InputError:
    there are more than `MOST_TRIANGLES`."""
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
    """A texture, (H, W, 4) sRGB and alpha, averaged until no edge is above 2048 pixels. Raises
    InputError: no whole picture of a known format, or one of more than `MOST_PIXELS`."""
    mend = f"use {', '.join(_FORMATS)}"
    image = Image.fromarray(rgba(decode_image(data, path, _FORMATS, MOST_PIXELS, what, mend)))
    return np.array(image.reduce(math.ceil(max(image.size) / _KEPT_EDGE)))


# glTF 2.0 (.glb, .gltf): the triangles of a scene with their base colours.
#
# Khronos, glTF 2.0 Specification, sections 3.5 to 3.9 and 4.4. Not through trimesh (5.2): it takes
# memory before sizes can be checked, leaves out pictures that it cannot open without a word, and
# knows neither texture transforms nor transmission, which is how glass is written today.

_GLOSSY, _TRANSMISSION = "KHR_materials_pbrSpecularGlossiness", "KHR_materials_transmission"
_PLACEMENT, _WEBP = "KHR_texture_transform", "EXT_texture_webp"
_UNLIT, _STRENGTH = "KHR_materials_unlit", "KHR_materials_emissive_strength"
_WRAPS: dict[int, Wrap] = {10497: "REPEAT", 33071: "CLAMP", 33648: "MIRROR"}
_MOST_TARGETS = 256  # of a primitive that move it: each costs as much as its positions
_CLEAREST = 0.08  # alpha of glass that transmits everything: what its two faces reflect


def read_glb(path: Path) -> list[Triangles]:
    """The triangles of a GLB's scene, in its frame (y up by the specification) and unit. Raises
    InputError: no whole GLB, a member that is missing or out of range, too large, compressed,
    rigged, or naming files that are not in its folder."""
    file = GlbFile(path)
    drawn, total = [], 0
    for one, pose, where in placed_primitives(file):
        if one.mode in (TRIANGLES, STRIP, FAN):
            count = _corner_count(file, one, where)
            total += count // 3 if one.mode == TRIANGLES else count
            require_few(path, total)
            drawn.append((one, pose, where))
    reader = _Reader(file)
    return checked(path, [reader.triangles(*one) for one in drawn])


def files_of_glb(path: Path) -> list[Path]:
    """Other files that a GLB names. Raises InputError: see `read_glb`."""
    tree = GlbFile(path).tree
    named = [("buffers", tree.buffers), ("images", tree.images)]
    found = [
        named_uri(path, one.uri, f"{field}.{index}.uri")
        for field, members in named
        for index, one in enumerate(members)
        if one.uri is not None
    ]
    return [one for one in found if one is not None]


def _corner_count(file: GlbFile, primitive: Primitive, field: str) -> int:
    """How many corners a primitive has. Raises InputError: it has no positions."""
    if "POSITION" not in primitive.attributes:
        raise file.fault(f"{field}.attributes", "lack POSITION")
    at = primitive.attributes["POSITION"]
    positions = file.at(file.tree.accessors, at, field)
    if positions.buffer_view is None and positions.sparse is None:
        raise file.no_data(f"accessors.{at}", primitive)
    if primitive.indices is None:
        return positions.count
    return file.at(file.tree.accessors, primitive.indices, field).count


@dataclass(frozen=True)
class _Surface:
    """A material, how it uses its texture, and the light that it emits."""

    material: MeshMaterial
    use: TextureUse | None = None
    glow: Glow | None = None
    glow_use: TextureUse | None = None


class _Reader:
    """Reads primitives; what several of them share, once."""

    def __init__(self, file: GlbFile) -> None:
        self._file = file
        self._surfaces: dict[int, _Surface] = {}
        self._textures: dict[int, NDArray[np.uint8]] = {}

    def triangles(self, primitive: Primitive, pose: Array, field: str) -> Triangles:
        """Triangles of a primitive, placed."""
        attributes, file = primitive.attributes, self._file
        faces = self._faces(primitive, field)
        surface = _Surface(MeshMaterial(np.ones(4)))
        if primitive.material is not None:
            if primitive.material not in self._surfaces:
                self._surfaces[primitive.material] = self._surface(primitive.material)
            surface = self._surfaces[primitive.material]
        uv = self._coordinates(primitive, surface.use, faces, field)
        glow, colours = surface.glow, None
        if glow is not None:
            glow = replace(glow, uv=self._coordinates(primitive, surface.glow_use, faces, field))
        if "COLOR_0" in attributes:
            index = attributes["COLOR_0"]
            colours = file.corners(index, f"{field}.COLOR_0", (3, 4), faces, shares=True)
            opaque = np.ones((*faces.shape, 4 - colours.shape[2]))
            colours = np.concatenate([colours, opaque], axis=2)
        corners = file.corners(attributes["POSITION"], f"{field}.POSITION", (3,), faces)
        weighted = zip(primitive.targets, primitive.weights, strict=False)
        moved = [(target, weight) for target, weight in weighted if weight]
        if len(moved) > _MOST_TARGETS:
            raise file.fault(f"{field}.targets", f"at most {_MOST_TARGETS} with a weight are read")
        for target, weight in moved:
            if "POSITION" in target:
                name = f"{field}.targets.POSITION"
                corners += weight * file.corners(target["POSITION"], name, (3,), faces)
        return Triangles(se3.apply(pose, corners), uv, colours, surface.material, glow)

    def _coordinates(
        self, primitive: Primitive, use: TextureUse | None, faces: NDArray[np.int64], field: str
    ) -> Array | None:
        """(F, 3, 2) texture coordinates for a use of a texture; None without one."""
        if use is None:
            return None
        placement = self._file.extension(use, _PLACEMENT, TextureTransform)
        name = f"TEXCOORD_{use.tex_coord}"
        if placement is not None and placement.tex_coord is not None:
            name = f"TEXCOORD_{placement.tex_coord}"
        if name not in primitive.attributes:
            raise self._file.fault(f"{field}.attributes", f"lack {name}, which the texture needs")
        uv = self._file.corners(primitive.attributes[name], f"{field}.{name}", (2,), faces)
        return uv if placement is None else placement.apply(uv)

    def _faces(self, primitive: Primitive, field: str) -> NDArray[np.int64]:
        """(F, 3) indices of vertices."""
        order = np.arange(_corner_count(self._file, primitive, field))
        if primitive.indices is not None:
            indices = self._file.array(primitive.indices, f"{field}.indices", (1,))[:, 0]
            if indices.dtype.kind != "u":
                raise self._file.fault(
                    f"{field}.indices", f"are {indices.dtype}, expected unsigned integers"
                )
            order = indices.astype(np.int64)
        if primitive.mode == TRIANGLES:
            return order[: len(order) // 3 * 3].reshape(-1, 3)
        first = order[:-2] if primitive.mode == STRIP else np.full(len(order[2:]), order[0])
        return np.stack([first, order[1:-1], order[2:]], axis=1)

    def _surface(self, index: int) -> _Surface:
        file = self._file
        surface = file.at(file.tree.materials, index, "material")
        metallic = surface.pbr_metallic_roughness
        colour, use = metallic.base_color_factor, metallic.base_color_texture
        gloss = 1 - metallic.roughness_factor
        glossy = file.extension(surface, _GLOSSY, Glossy)
        if glossy is not None:
            colour, use = glossy.diffuse_factor, glossy.diffuse_texture
            gloss = glossy.glossiness_factor
        factor, alpha = np.array(colour), surface.alpha_mode
        clear = file.extension(surface, _TRANSMISSION, Transmission)
        if clear is not None and clear.transmission_factor > 0:
            factor[3] *= max(1 - clear.transmission_factor, _CLEAREST)
            alpha = "BLEND"
        picture, wrap = self._texture(use)
        lit = _UNLIT not in surface.extensions
        cutoff = surface.alpha_cutoff
        material = MeshMaterial(factor, picture, alpha, cutoff, gloss, wrap, lit)
        emitted = np.array(surface.emissive_factor)
        if not lit or not emitted.any():  # what is unlit shows its base colour alone
            return _Surface(material, use)
        strength = file.extension(surface, _STRENGTH, EmissiveStrength)
        emitted *= 1.0 if strength is None else strength.emissive_strength
        picture, wrap = self._texture(surface.emissive_texture)
        glow = Glow(emitted, picture, wrap=wrap)
        return _Surface(material, use, glow, surface.emissive_texture)

    def _texture(
        self, use: TextureUse | None
    ) -> tuple[NDArray[np.uint8] | None, tuple[Wrap, Wrap]]:
        """Pixels of a texture and how it goes on beyond them; none without a use of one."""
        if use is None:
            return None, REPEATED
        file = self._file
        texture, field = file.at(file.tree.textures, use.index, "texture"), f"textures.{use.index}"
        webp = file.extension(texture, _WEBP, GltfTexture)
        source = texture.source if webp is None else webp.source
        if source is None:
            named = ", ".join(texture.extensions) or "it names no source"
            raise file.fault(field, f"has no image of a supported format ({named})")
        if source not in self._textures:
            if len(self._textures) >= MOST_TEXTURES:
                raise file.fault("images", f"at most {MOST_TEXTURES} are read")
            data = self._picture(source, field)
            self._textures[source] = decoded(file.path, data, f"images.{source}")
        wrap = REPEATED
        if texture.sampler is not None:
            sampler = file.at(file.tree.samplers, texture.sampler, f"{field}.sampler")
            wrap = _WRAPS[sampler.wrap_s], _WRAPS[sampler.wrap_t]
        return self._textures[source], wrap

    def _picture(self, index: int, field: str) -> bytes:
        file = self._file
        image = file.at(file.tree.images, index, f"{field}.source")
        if image.uri is not None:
            return data_of(file.path, image.uri, f"images.{index}.uri")
        if image.buffer_view is None:
            raise file.fault(f"images.{index}", "has neither uri nor bufferView")
        return bytes(file.view(image.buffer_view, f"images.{index}.bufferView"))
