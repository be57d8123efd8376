"""Files with the weights of one network, as torch or safetensors save them, never unpickled."""

from __future__ import annotations

import pickle
import zipfile
from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from recast.errors import InputError


def read_weights(path: Path, what: str, mend: str) -> Mapping[str, Tensor]:
    """Read a table of tensors on the CPU.

    Args:
        path: .safetensors, or anything else as torch saves it.
        what: the weights are, for messages.
        mend: what the user can do about any fault.

    Raises:
        InputError: no file, unreadable, or something else than a table of tensors.
    """
    if not path.is_file():
        raise InputError(path, what, "is no file", "check the path")
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        state = torch.load(path, map_location="cpu", weights_only=True)
    except (
        SafetensorError, pickle.UnpicklingError, RuntimeError, EOFError, zipfile.BadZipFile
    ) as error:  # fmt: skip
        first_line = str(error).strip().splitlines()[0] if str(error).strip() else "cut short"
        raise InputError(path, what, f"cannot be read ({first_line})", mend) from None
    if not isinstance(state, dict) or not all(isinstance(v, Tensor) for v in state.values()):
        raise InputError(path, what, "is no table of tensors", mend)
    return state


def checked_weight(
    state: Mapping[str, Tensor], name: str, shape: tuple[int, ...], path: Path, mend: str
) -> Tensor:
    """A tensor of the table in float32.

    Raises:
        InputError: it is missing, of another shape, or has a value that is not finite.
    """
    tensor = state.get(name)
    if tensor is None:
        raise InputError(path, name, "is missing", mend)
    if tuple(tensor.shape) != shape:
        raise InputError(path, name, f"has shape {tuple(tensor.shape)}, not {shape}", mend)
    tensor = tensor.float()
    if not bool(tensor.isfinite().all()):
        raise InputError(path, name, "has values that are not finite", mend)
    return tensor
