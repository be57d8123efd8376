"""glTF 2.0 in a binary file (GLB): the triangles of a scene with their base colours.

Khronos, glTF 2.0 Specification, sections 3.5 to 3.9 and 4.4. Not through trimesh (5.2): it takes
memory before sizes can be checked, leaves out pictures that it cannot open without a word, and
knows neither texture transforms nor transmission, which is how glass is written today.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast.actors.mesh.triangles import (
    MOST_TEXTURES,
    Array,
    Material,
    Triangles,
    checked,
    decoded,
    require_few,
)
from recast.core.gltf.file import GlbFile, data_of, named_uri
from recast.core.gltf.tree import (
    FAN,
    STRIP,
    TRIANGLES,
    Glossy,
    Placement,
    Primitive,
    Texture,
    TextureUse,
    Transmission,
    placed_primitives,
)
from recast.geometry import se3

_GLOSSY, _TRANSMISSION = "KHR_materials_pbrSpecularGlossiness", "KHR_materials_transmission"
_PLACEMENT, _WEBP = "KHR_texture_transform", "EXT_texture_webp"
_CLEAREST = 0.08  # alpha of glass that transmits everything: what its two faces reflect


def read_glb(path: Path) -> list[Triangles]:
    """The triangles of a GLB's scene, in its frame (y up by the specification) and unit.

    Raises:
        InputError: no whole GLB, a member that is missing or out of range, too large, compressed,
            rigged, or naming files that are not in its folder.
    """
    file = GlbFile(path)
    drawn, total = [], 0
    for one, pose, field in placed_primitives(file):
        if one.mode in (TRIANGLES, STRIP, FAN):
            count = _corner_count(file, one, field)
            total += count // 3 if one.mode == TRIANGLES else count
            require_few(path, total)
            drawn.append((one, pose, field))
    reader = _Reader(file)
    return checked(path, [reader.triangles(*one) for one in drawn])


def files_of_glb(path: Path) -> list[Path]:
    """Other files that a GLB names.

    Raises:
        InputError: see `read_glb`.
    """
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
    """How many corners a primitive has.

    Raises:
        InputError: it has no positions.
    """
    if "POSITION" not in primitive.attributes:
        raise file.fault(f"{field}.attributes", "lack POSITION")
    index = primitive.indices
    if index is None:
        index = primitive.attributes["POSITION"]
    return file.at(file.tree.accessors, index, field).count


class _Reader:
    """Reads primitives; what several of them share, once."""

    def __init__(self, file: GlbFile) -> None:
        self._file = file
        self._materials: dict[int, tuple[Material, TextureUse | None]] = {}
        self._textures: dict[int, NDArray[np.uint8]] = {}

    def triangles(self, primitive: Primitive, pose: Array, field: str) -> Triangles:
        """Triangles of a primitive, placed."""
        attributes, file = primitive.attributes, self._file
        faces = self._faces(primitive, field)
        material, use = Material(np.ones(4)), None
        if primitive.material is not None:
            material, use = self._material(primitive.material)
        uv = colours = None
        if use is not None:
            placement = file.extension(use, _PLACEMENT, Placement)
            name = f"TEXCOORD_{use.tex_coord}"
            if placement is not None and placement.tex_coord is not None:
                name = f"TEXCOORD_{placement.tex_coord}"
            if name not in attributes:
                raise file.fault(f"{field}.attributes", f"lack {name}, which the texture needs")
            uv = file.corners(attributes[name], f"{field}.{name}", (2,), faces)
            uv = uv if placement is None else placement.apply(uv)
        if "COLOR_0" in attributes:
            colours = file.corners(attributes["COLOR_0"], f"{field}.COLOR_0", (3, 4), faces)
            opaque = np.ones((*faces.shape, 4 - colours.shape[2]))
            colours = np.concatenate([colours, opaque], axis=2)
        corners = file.corners(attributes["POSITION"], f"{field}.POSITION", (3,), faces)
        return Triangles(se3.apply(pose, corners), uv, colours, material)

    def _faces(self, primitive: Primitive, field: str) -> NDArray[np.int64]:
        """(F, 3) indices of vertices."""
        order = np.arange(_corner_count(self._file, primitive, field))
        if primitive.indices is not None:
            indices = self._file.array(primitive.indices, f"{field}.indices", (1,))[:, 0]
            if indices.dtype.kind != "u":
                raise self._file.fault(f"{field}.indices", f"are of type {indices.dtype}")
            order = indices.astype(np.int64)
        if primitive.mode == TRIANGLES:
            return order[: len(order) // 3 * 3].reshape(-1, 3)
        first = order[:-2] if primitive.mode == STRIP else np.full(len(order[2:]), order[0])
        return np.stack([first, order[1:-1], order[2:]], axis=1)

    def _material(self, index: int) -> tuple[Material, TextureUse | None]:
        """A material, and how it uses its texture."""
        if index not in self._materials:
            self._materials[index] = self._read_material(index)
        return self._materials[index]

    def _read_material(self, index: int) -> tuple[Material, TextureUse | None]:
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
        picture = None if use is None else self._texture(use.index)
        return Material(factor, picture, alpha, surface.alpha_cutoff, gloss), use

    def _texture(self, index: int) -> NDArray[np.uint8]:
        file = self._file
        texture, field = file.at(file.tree.textures, index, "texture"), f"textures.{index}"
        webp = file.extension(texture, _WEBP, Texture)
        source = texture.source if webp is None else webp.source
        if source is None:
            raise file.fault(field, "has no picture, or one of a format that is not read")
        if source not in self._textures:
            if len(self._textures) >= MOST_TEXTURES:
                raise file.fault("images", f"{MOST_TEXTURES} of base colours are the most")
            data = self._picture(source, field)
            self._textures[source] = decoded(file.path, data, f"images.{source}")
        return self._textures[source]

    def _picture(self, index: int, field: str) -> bytes:
        file = self._file
        image = file.at(file.tree.images, index, f"{field}.source")
        if image.uri is not None:
            return data_of(file.path, image.uri, f"images.{index}.uri")
        if image.buffer_view is None:
            raise file.fault(f"images.{index}", "has neither uri nor bufferView")
        return bytes(file.view(image.buffer_view, f"images.{index}.bufferView"))
