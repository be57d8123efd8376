"""Conversions after a download: from a publisher's layout to one that recast reads."""

from __future__ import annotations

from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import save_file

from recast.errors import InputError
from recast.storage import atomic_file
from recast.torch_file import read_tensors

_PICKLE, _SAFETENSORS = "pytorch_model.bin", "model.safetensors"


def safetensors_of_pickle(folder: Path) -> None:
    """Write model.safetensors from pytorch_model.bin, of which nothing but tensors is unpickled.

    Names, types and values stay; tensors that share memory are stored apart.

    Raises:
        InputError: the file holds other objects than tensors, or the disk refuses.
    """
    found = read_tensors(folder / _PICKLE, "weights", "remove the folder and fetch it again")
    apart: dict[str, torch.Tensor] = {}
    memory: set[int] = set()
    for name, tensor in found.items():
        dense = tensor.contiguous()
        at = dense.untyped_storage().data_ptr()
        apart[name] = dense.clone() if at in memory else dense
        memory.add(at)
    with atomic_file(folder / _SAFETENSORS) as partial:
        try:
            save_file(apart, partial, {"format": "pt"})
        except SafetensorError as error:  # a full disk is said in a way of its own
            problem = f"cannot be written ({error})"
            raise InputError(
                folder / _SAFETENSORS, "file", problem, "free some space and run again"
            ) from error
