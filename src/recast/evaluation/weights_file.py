"""Single tensors of a network's weights, looked at before they are used."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from torch import Tensor

from recast.errors import InputError


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
