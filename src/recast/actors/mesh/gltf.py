"""glTF 2.0 in a binary file (GLB): the triangles of a scene with their base colours.

Khronos, glTF 2.0 Specification, sections 3.5 to 3.9 and 4.4. Not through trimesh (5.2): it takes
memory before sizes can be checked, leaves out pictures that it cannot open without a word, and
knows neither texture transforms nor transmission, which is how glass is written today. Arrays stay
where they lie in the file, so that what a file claims takes no memory.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from recast.actors.mesh.gltf_tree import (
    STRIP,
    TRIANGLES,
    Glossy,
    Part,
    Placement,
    Primitive,
    Texture,
    TextureUse,
    Transmission,
    Tree,
    corner_count,
    placed_primitives,
)
from recast.actors.mesh.triangles import (
    MOST_BYTES,
    MOST_TEXTURES,
    Array,
    Material,
    Triangles,
    checked,
    data_of,
    decoded,
    named_uri,
)
from recast.core import files
from recast.core.errors import InputError
from recast.core.records import validation_error
from recast.geometry import se3

One = TypeVar("One")
Kind = TypeVar("Kind", bound=Part)

_MEND = "export it again as plain glTF 2.0 binary (.glb), uncompressed and without a rig"
_JSON_BYTES = 1 << 25
_GLB, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_UNREADABLE = ("compression", "instancing")  # in names of extensions that change geometry
_GLOSSY, _TRANSMISSION = "KHR_materials_pbrSpecularGlossiness", "KHR_materials_transmission"
_PLACEMENT, _WEBP = "KHR_texture_transform", "EXT_texture_webp"
_CLEAREST = 0.08  # alpha of glass that transmits everything: what its two faces reflect


class GlbFile:
    """An open file; `tree` is its JSON chunk.

    Raises:
        InputError: no whole GLB, a member that is missing or out of range, or compressed. Also from
            the methods: there is no such member, it is wrong, of another width or with too few
            rows, or not all of it is there.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        chunks = self._chunks(memoryview(files.read_bytes(path, MOST_BYTES)))
        if len(chunks.get(_JSON, b"")) not in range(1, _JSON_BYTES):
            raise self.fault("JSON", f"is missing, or of more than {_JSON_BYTES} bytes")
        try:
            self.tree = Tree.model_validate(files.parse_json(path, bytes(chunks[_JSON])))
        except ValidationError as error:
            raise validation_error(path, error, _MEND) from None
        for name in self.tree.extensions_required:
            if any(word in name.lower() for word in _UNREADABLE):
                raise self.fault("extensionsRequired", f"names {name}, which is not read")
        self._buffers: dict[int, memoryview] = {}
        if _BIN in chunks and self.tree.buffers and self.tree.buffers[0].uri is None:
            self._buffers[0] = chunks[_BIN]

    def fault(self, field: str, problem: str) -> InputError:
        """The error of a member."""
        return InputError(self.path, field, problem, _MEND)

    def at(self, members: Sequence[One], index: int, field: str) -> One:
        """The member that `field` names by its index."""
        if not 0 <= index < len(members):
            raise self.fault(field, f"is {index}, of {len(members)}")
        return members[index]

    def extension(self, owner: Part, name: str, kind: type[Kind]) -> Kind | None:
        """An extension of an object; None if it has none of that name."""
        if name not in owner.extensions:
            return None
        try:
            return kind.model_validate(owner.extensions[name])
        except ValidationError as error:
            fault = validation_error(self.path, error, _MEND)
            raise self.fault(f"{name}.{fault.field}", fault.problem) from None

    def view(self, index: int, field: str) -> memoryview:
        """The bytes of a buffer view."""
        view = self.at(self.tree.buffer_views, index, field)
        buffer = self._buffer(view.buffer)
        end = view.byte_offset + view.byte_length
        if end > len(buffer):
            raise self.fault(f"bufferViews.{index}", f"ends at byte {end} of {len(buffer)}")
        return buffer[view.byte_offset : end]

    def array(self, index: int, field: str, widths: tuple[int, ...]) -> NDArray[Any]:
        """An accessor's numbers (N, width), where they lie; its width is one of `widths`."""
        accessor = self.at(self.tree.accessors, index, field)
        width = _WIDTHS.get(accessor.type, 0)
        if width not in widths:
            raise self.fault(field, f"is of type {accessor.type}")
        if accessor.buffer_view is None or accessor.sparse is not None:
            raise self.fault(f"accessors.{index}", "is sparse or without data, which is not read")
        data = self.view(accessor.buffer_view, f"accessors.{index}.bufferView")
        dtype = np.dtype(_TYPES[accessor.component_type])
        stride = self.tree.buffer_views[accessor.buffer_view].byte_stride or width * dtype.itemsize
        end = accessor.byte_offset + (accessor.count - 1) * stride + width * dtype.itemsize
        if end > len(data):
            raise self.fault(f"accessors.{index}", f"ends at byte {end} of {len(data)}")
        return np.ndarray(
            (accessor.count, width), dtype, data, accessor.byte_offset, (stride, dtype.itemsize)
        )

    def corners(
        self, index: int, field: str, widths: tuple[int, ...], faces: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """An accessor's numbers at the corners of faces (F, 3), (F, 3, width); shares as such.

        Only what is asked for becomes floats: primitives may share one array of all vertices.
        """
        values = self.array(index, field, widths)
        if len(faces) and faces.max() >= len(values):
            raise self.fault(field, f"has {len(values)} rows, the indices go up to {faces.max()}")
        found = values[faces].astype(np.float64)
        if self.tree.accessors[index].normalized and values.dtype.kind != "f":
            found = np.maximum(found / np.iinfo(values.dtype).max, -1.0)
        return found

    def _buffer(self, index: int) -> memoryview:
        if index not in self._buffers:
            uri = self.at(self.tree.buffers, index, "buffer").uri
            if uri is None:
                raise self.fault(f"buffers.{index}", "has no data")
            self._buffers[index] = memoryview(data_of(self.path, uri, f"buffers.{index}.uri"))
        return self._buffers[index]

    def _chunks(self, data: memoryview) -> dict[int, memoryview]:
        """The first chunk of each type."""
        if len(data) < 20 or struct.unpack("<II", data[:8]) != (_GLB, 2):
            raise self.fault("header", "is not that of a binary glTF 2.0 file")
        found: dict[int, memoryview] = {}
        at = 12
        while at + 8 <= len(data):
            length, kind = struct.unpack("<II", data[at : at + 8])
            if at + 8 + length > len(data):
                problem = f"of {length} bytes at byte {at}, but {len(data) - at - 8} are left"
                raise self.fault("chunk", problem)
            found.setdefault(kind, data[at + 8 : at + 8 + length])
            at += 8 + length
        return found


def read_glb(path: Path) -> list[Triangles]:
    """The triangles of a GLB's scene, in its frame (y up by the specification) and unit.

    Raises:
        InputError: no whole GLB, a member that is missing or out of range, too large, compressed,
            rigged, or naming files that are not in its folder.
    """
    file = GlbFile(path)
    reader = _Reader(file)
    return checked(path, [reader.triangles(*one) for one in placed_primitives(file)])


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
        order = np.arange(corner_count(self._file, primitive, field))
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
