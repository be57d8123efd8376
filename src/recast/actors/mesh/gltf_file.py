"""A binary glTF 2.0 file (GLB): its tree, and the bytes that the tree points at.

Khronos, glTF 2.0 Specification, sections 3.5, 3.6 and 4.4. Arrays stay where they lie in the file,
so that what a file claims takes no memory.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from recast import storage
from recast.actors.mesh.gltf_tree import Part, Tree
from recast.actors.mesh.named_files import MOST_BYTES, data_of
from recast.errors import InputError
from recast.records import validation_error

One = TypeVar("One")
Kind = TypeVar("Kind", bound=Part)

_MEND = "export it again as plain glTF 2.0 binary (.glb), uncompressed and without a rig"
_JSON_BYTES = 1 << 25
_GLB, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_UNREADABLE = ("compression", "instancing")  # in names of extensions that change geometry


class GlbFile:
    """An open file.

    Attributes:
        path: of the file.
        tree: its JSON chunk.

    Raises:
        InputError: no whole GLB, a member that is missing or out of range, or compressed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        chunks = self._chunks(memoryview(storage.read_bytes(path, MOST_BYTES)))
        if len(chunks.get(_JSON, b"")) not in range(1, _JSON_BYTES):
            raise self.fault("JSON", f"is missing, or of more than {_JSON_BYTES} bytes")
        try:
            self.tree = Tree.model_validate(storage.parse_json(path, bytes(chunks[_JSON])))
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
        """The member that `field` names by its index.

        Raises:
            InputError: there is none.
        """
        if not 0 <= index < len(members):
            raise self.fault(field, f"is {index}, of {len(members)}")
        return members[index]

    def extension(self, owner: Part, name: str, kind: type[Kind]) -> Kind | None:
        """An extension of an object; None if it has none of that name.

        Raises:
            InputError: a member of it is wrong.
        """
        if name not in owner.extensions:
            return None
        try:
            return kind.model_validate(owner.extensions[name])
        except ValidationError as error:
            fault = validation_error(self.path, error, _MEND)
            raise self.fault(f"{name}.{fault.field}", fault.problem) from None

    def view(self, index: int, field: str) -> memoryview:
        """The bytes of a buffer view.

        Raises:
            InputError: there is none, or not all of it is there.
        """
        view = self.at(self.tree.buffer_views, index, field)
        buffer = self._buffer(view.buffer)
        end = view.byte_offset + view.byte_length
        if end > len(buffer):
            raise self.fault(f"bufferViews.{index}", f"ends at byte {end} of {len(buffer)}")
        return buffer[view.byte_offset : end]

    def array(self, index: int, field: str, widths: tuple[int, ...]) -> NDArray[Any]:
        """An accessor's numbers (N, width), where they lie.

        Raises:
            InputError: there is none, it is of another width, or not all of it is there.
        """
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

        Raises:
            InputError: see `array`; or it has too few rows.
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
