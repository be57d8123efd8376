"""The safetensors format: element types, order of the tensors, and the header of a file.

A file is the header's length (8 bytes, little-endian), a JSON header of names, types, shapes and
byte ranges, padded with blanks to a multiple of 8 bytes, and the tensors one after another.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch

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
