"""Headers of safetensors files: read without their tensors, written, and held against a model.

A file is the header's length (8 bytes, little-endian), a JSON header of names, types, shapes and
byte ranges, padded with blanks to a multiple of 8 bytes, and the tensors one after another.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import torch

from recast.core.errors import InputError

LENGTH_BYTES = 8

# In ascending order of the format's own types: files hold the last ones first.
_ASCENDING: tuple[tuple[str, torch.dtype], ...] = (
    ("BOOL", torch.bool),
    ("U8", torch.uint8),
    ("I8", torch.int8),
    ("I16", torch.int16),
    ("F16", torch.float16),
    ("BF16", torch.bfloat16),
    ("I32", torch.int32),
    ("F32", torch.float32),
    ("F64", torch.float64),
    ("I64", torch.int64),
)
DTYPES: Mapping[str, torch.dtype] = dict(_ASCENDING)
CODES: Mapping[torch.dtype, str] = {dtype: code for code, dtype in _ASCENDING}
_RANK = {code: rank for rank, (code, _) in enumerate(_ASCENDING)}
MAX_HEADER_BYTES = 100_000_000  # the limit of the format
_PICKLES = (b"PK\x03\x04", b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")
_MEND = "fetch or write the file anew"


@dataclass(frozen=True)
class TensorSpec:
    """Shape and element type of a tensor.

    Attributes:
        dtype: the format's code, such as "F16".
        shape: as in torch.
    """

    dtype: str
    shape: tuple[int, ...]

    @property
    def elements(self) -> int:
        """Number of elements; one for a scalar."""
        return math.prod(self.shape)

    @property
    def nbytes(self) -> int:
        """Bytes of the elements."""
        return self.elements * DTYPES[self.dtype].itemsize

    def __str__(self) -> str:
        return f"{self.dtype} {list(self.shape)}"


def tensor_specs(tensors: Mapping[str, torch.Tensor]) -> dict[str, TensorSpec]:
    """Types and shapes of tensors, which may be on the meta device."""
    return {
        name: TensorSpec(CODES[tensor.dtype], tuple(tensor.shape))
        for name, tensor in tensors.items()
    }


def file_bytes(specs: Mapping[str, TensorSpec]) -> int:
    """Size of the file that holds these tensors and no metadata."""
    header = len(json.dumps(_header(specs), separators=(",", ":"), ensure_ascii=False).encode())
    padded = -(-header // LENGTH_BYTES) * LENGTH_BYTES
    return LENGTH_BYTES + padded + sum(spec.nbytes for spec in specs.values())


def _header(specs: Mapping[str, TensorSpec]) -> dict[str, dict[str, object]]:
    header: dict[str, dict[str, object]] = {}
    end = 0
    for name in sorted(specs, key=lambda name: (-_RANK[specs[name].dtype], name)):
        spec = specs[name]
        begin, end = end, end + spec.nbytes
        header[name] = {
            "dtype": spec.dtype,
            "shape": list(spec.shape),
            "data_offsets": [begin, end],
        }
    return header


@dataclass(frozen=True)
class Header:
    """What a safetensors file says about itself.

    Attributes:
        path: the file.
        specs: type and shape of every tensor, by name.
        file_bytes: size of the whole file.
    """

    path: Path
    specs: dict[str, TensorSpec]
    file_bytes: int


def read_header(path: Path) -> Header:
    """Read and check the header: every tensor lies inside the file, and they fill it exactly.

    Raises:
        InputError: the file is missing, truncated, has bytes to spare, or is of another kind,
            such as a pickled PyTorch file.
    """
    try:
        with path.open("rb") as file:
            return _read(path, file)
    except (FileNotFoundError, IsADirectoryError, PermissionError) as error:
        problem = (error.strerror or "cannot be read").lower()
        raise InputError(path, "file", problem, "check the folder") from None


def _read(path: Path, file: BinaryIO) -> Header:
    size = path.stat().st_size
    start = file.read(LENGTH_BYTES)
    if start.startswith(_PICKLES):
        raise InputError(
            path,
            "file",
            "is a pickled PyTorch file, not safetensors",
            "convert it where it came from; pickles are never loaded",
        )
    if len(start) < LENGTH_BYTES:
        raise InputError(path, "file", f"has {size} bytes, less than any safetensors file", _MEND)
    length = int.from_bytes(start, "little")
    if length > MAX_HEADER_BYTES:
        raise InputError(path, "file", "is no safetensors file (header length out of range)", _MEND)
    if LENGTH_BYTES + length > size:
        raise InputError(
            path, "header", f"has {length} bytes in a file of {size}: truncated", _MEND
        )
    entries = _parse(path, file.read(length))
    entries.pop("__metadata__", None)
    specs: dict[str, TensorSpec] = {}
    ranges: list[tuple[int, int, str]] = []
    for name, entry in entries.items():
        specs[name], begin, end = _entry(path, name, entry)
        ranges.append((begin, end, name))
    position = 0
    for begin, end, name in sorted(ranges):
        if begin != position:
            raise InputError(
                path, name, f"begins at byte {begin} of the data, not {position}", _MEND
            )
        position = end
    needed = LENGTH_BYTES + length + position
    if needed != size:
        what = "truncated" if needed > size else "with bytes behind the last tensor"
        raise InputError(path, "file", f"has {size} bytes, not {needed}: {what}", _MEND)
    return Header(path, specs, size)


def _parse(path: Path, text: bytes) -> dict[str, Any]:
    try:
        header = json.loads(text, object_pairs_hook=_unique)
    except (ValueError, RecursionError):
        header = None
    if not isinstance(header, dict):
        raise InputError(path, "header", "is not the JSON of a safetensors file", _MEND)
    return header


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) != len(pairs):
        raise ValueError("a name occurs twice")
    return members


def _entry(path: Path, name: str, entry: Any) -> tuple[TensorSpec, int, int]:
    # json gives bool for true, which is an int in Python: `type` tells them apart.
    members: dict[str, Any] = entry if isinstance(entry, dict) else {}
    dtype: Any = members.get("dtype")
    shape: Any = members.get("shape")
    offsets: Any = members.get("data_offsets")
    if not isinstance(dtype, str) or dtype not in DTYPES:
        raise InputError(path, name, f"has an unknown element type ({dtype!r})", _MEND)
    if not _sizes(shape) or not _sizes(offsets) or len(offsets) != 2:
        raise InputError(path, name, "has no valid shape and byte range", _MEND)
    spec = TensorSpec(dtype, tuple(shape))
    begin, end = offsets
    if end - begin != spec.nbytes:
        raise InputError(
            path, name, f"takes {end - begin} bytes, {spec} needs {spec.nbytes}", _MEND
        )
    return spec, begin, end


def _sizes(value: Any) -> bool:
    return isinstance(value, list) and all(type(size) is int and size >= 0 for size in value)


@dataclass(frozen=True)
class ModelCheck:
    """What was found of one model, and what its class expects.

    Attributes:
        role: in `pipeline.json`.
        file: the weights, or what names them.
        class_name: published name of the class; empty where it could not be told.
        found: type and shape of each tensor in the file.
        expected: type and shape of each tensor of the class.
        bytes_found: size of the file.
        parameters: trainable numbers of the class, saved buffers left out.
        not_finite: tensors with NaN or infinite values; only where values were read.
        error: the file cannot be read, or its class cannot be built; nothing else is known then.
        note: why nothing was checked, of a model that may be absent.
    """

    role: str
    file: Path
    class_name: str = ""
    found: Mapping[str, TensorSpec] | None = None
    expected: Mapping[str, TensorSpec] | None = None
    bytes_found: int = 0
    parameters: int = 0
    not_finite: tuple[str, ...] = ()
    error: InputError | None = None
    note: str = ""

    @property
    def missing(self) -> tuple[str, ...]:
        """Tensors of the class that the file lacks."""
        return tuple(sorted({*(self.expected or ())} - {*(self.found or ())}))

    @property
    def unexpected(self) -> tuple[str, ...]:
        """Tensors of the file that the class does not have."""
        return tuple(sorted({*(self.found or ())} - {*(self.expected or ())}))

    @property
    def wrong_shape(self) -> tuple[str, ...]:
        """Tensors of another shape."""
        return tuple(name for name, found, wanted in self._both() if found.shape != wanted.shape)

    @property
    def wrong_dtype(self) -> tuple[str, ...]:
        """Tensors of another element type; loading converts between floating-point types."""
        return tuple(name for name, found, wanted in self._both() if found.dtype != wanted.dtype)

    @property
    def bytes_expected(self) -> int:
        """Size of the file of this class without metadata."""
        return file_bytes(self.expected) if self.expected else 0

    def fault(self, *, loading: bool = False) -> InputError | None:
        """The error that stands for all that is wrong, or None.

        It names the file and the first bad tensor, and counts the others.

        Args:
            loading: let another floating-point type pass, which loading converts.
        """
        if self.error is not None:
            return self.error
        dtypes = tuple(n for n in self.wrong_dtype if not (loading and self._converts(n)))
        for names, problem in (
            (self.wrong_shape, self._difference),
            (self.missing, lambda name: f"is missing of {self.class_name}"),
            (self.unexpected, lambda name: f"is not expected in {self.class_name}"),
            (dtypes, self._difference),
            (self.not_finite, lambda name: "holds NaN or infinite values"),
        ):
            if names:
                counts = (
                    f"{len(self.missing)} missing, {len(self.unexpected)} unexpected, "
                    f"{len(self.wrong_shape)} of another shape, {len(dtypes)} of another type"
                )
                if self.not_finite:
                    counts += f", {len(self.not_finite)} not finite"
                return InputError(self.file, names[0], f"{problem(names[0])} ({counts})", _MEND)
        return None

    def _both(self) -> list[tuple[str, TensorSpec, TensorSpec]]:
        found, expected = self.found or {}, self.expected or {}
        return [(name, found[name], expected[name]) for name in sorted({*found} & {*expected})]

    def _difference(self, name: str) -> str:
        assert self.found and self.expected
        return f"is {self.found[name]}, {self.class_name} has {self.expected[name]}"

    def _converts(self, name: str) -> bool:
        assert self.found
        return DTYPES[self.found[name].dtype].is_floating_point
