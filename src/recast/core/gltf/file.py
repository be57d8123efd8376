"""glTF 2.0 in a binary file (GLB): the container, its accessors and the buffers that it names.

Khronos, glTF 2.0 Specification, sections 3.5, 3.6 and 4.4. Arrays stay where they lie in the file,
so that what a file claims takes no memory.
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from recast.core import files
from recast.core.errors import InputError
from recast.core.gltf.tree import Part, Tree
from recast.core.names import member
from recast.core.records import validation_error

One = TypeVar("One")
Kind = TypeVar("Kind", bound=Part)

MOST_BYTES = 1 << 29
"""Maximum size in bytes of a file of triangles, and of any file that it names."""
LONGEST_GLB = (1 << 32) - 1
"""Bytes that the container's header can tell."""
_MEND = "export it again as plain glTF 2.0 binary (.glb), uncompressed and without a rig"
_JSON_BYTES = 1 << 25
_GLB, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_UNREADABLE = ("compression", "instancing")  # in names of extensions that change geometry


class GlbFile:
    """An open file; `tree` is its JSON chunk.

    Raises:
        InputError: no whole GLB, a member that is missing or out of range, or compressed. Also from
            the methods: there is no such member, it is wrong, of another width or with too few
            rows, or not all of it is there.
    """

    def __init__(self, path: Path, most_bytes: int = MOST_BYTES) -> None:
        self.path = path
        chunks = self._chunks(memoryview(files.read_bytes(path, most_bytes)))
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
        return self._shares(index, values[faces].astype(np.float64), values.dtype)

    def rows(
        self, index: int, field: str, widths: tuple[int, ...], count: int
    ) -> NDArray[np.float32]:
        """An accessor's numbers (`count`, width); shares as such."""
        values = self.array(index, field, widths)
        if len(values) != count:
            raise self.fault(field, f"has {len(values)} rows, not {count}")
        return self._shares(index, values.astype(np.float32), values.dtype)

    def _shares(self, index: int, values: NDArray[Any], kind: np.dtype) -> NDArray[Any]:
        """Numbers that an accessor stored as `kind`, normalised if it says so (section 3.6.2.2)."""
        if self.tree.accessors[index].normalized and kind.kind != "f":
            return np.maximum(values / np.iinfo(kind).max, -1.0).astype(values.dtype)
        return values

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


def named_uri(path: Path, uri: str, what: str) -> Path | None:
    """The file that a glTF URI names, see `names.member`; None if the data stands in the URI."""
    if uri.startswith("data:"):
        return None
    return member(path.parent, unquote(uri).replace("\\", "/"), path, what)


def data_of(path: Path, uri: str, what: str) -> bytes:
    """The bytes of a glTF URI: base64 in place, or a file.

    Raises:
        InputError: the base64 is broken, or see `names.member` and `files.read_bytes`.
    """
    file = named_uri(path, uri, what)
    if file is not None:
        return files.read_bytes(file, MOST_BYTES)
    head, _, text = uri.partition(",")
    try:
        if head.endswith(";base64"):
            return base64.b64decode(text, validate=True)
    except ValueError:
        pass
    raise InputError(path, what, "is no base64", "export it again")


def write_glb(path: str | Path, tree: Mapping[str, Any], binary: bytes) -> None:
    """Write a GLB, whole or not at all.

    Args:
        tree: the JSON chunk, whose first buffer is `binary`.

    Raises:
        InputError: the file would be larger than a GLB can be, or the disk refuses.
    """
    text = json.dumps(tree, separators=(",", ":"), allow_nan=False).encode()
    chunks = [(_JSON, text + b" " * (-len(text) % 4)), (_BIN, binary + bytes(-len(binary) % 4))]
    length = 12 + sum(8 + len(data) for _, data in chunks)
    if length > LONGEST_GLB:
        problem = f"would have {length} bytes, a GLB has {LONGEST_GLB} at most"
        raise InputError(path, "size", problem, "write its parts, or another format")
    parts = [struct.pack("<III", _GLB, 2, length)]
    for kind, data in chunks:
        parts += [struct.pack("<II", len(data), kind), data]
    files.write_bytes(path, b"".join(parts))
