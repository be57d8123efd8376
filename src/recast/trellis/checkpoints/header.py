"""Reads the header of a safetensors file without touching its tensors, and checks its bounds."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from recast.errors import InputError
from recast.trellis.checkpoints.layout import DTYPES, LENGTH_BYTES, TensorSpec

MAX_HEADER_BYTES = 100_000_000  # the limit of the format
_PICKLES = (b"PK\x03\x04", b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")
_MEND = "fetch or write the file anew"


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
            path, "file", "is a pickled PyTorch file, not safetensors",
            "convert it where it came from; pickles are never loaded",
        )  # fmt: skip
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
