"""Named tensors with a JSON header in one safetensors file, written whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors.torch import save
from torch import Tensor

from recast.errors import InputError
from recast.storage import parse_json, write_bytes
from recast.torch_file import read_safetensors

HEADER = "recast"


def write_tensors(path: Path, tensors: Mapping[str, Tensor], header: Mapping[str, Any]) -> None:
    """Write tensors and header atomically.

    Raises:
        InputError: the disk refuses.
    """
    plain = {name: t.detach().to("cpu", copy=True).contiguous() for name, t in tensors.items()}
    write_bytes(path, save(plain, metadata={HEADER: json.dumps(header)}))


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors and header of a file.

    Raises:
        InputError: missing, cut short, or not ours.
    """
    tensors, texts = read_safetensors(path, "tensors", "write it anew")
    header = parse_json(path, texts.get(HEADER, ""))
    if not isinstance(header, dict):
        raise InputError(path, "header", "is no object", "write it anew")
    return tensors, header
