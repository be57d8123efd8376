"""Weights from files: released Lightning checkpoints and safetensors, loaded strictly."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from recast.errors import InputError
from recast.planning.gtrs.model import GtrsModel
from recast.storage import disk_errors
from recast.torch_file import read_safetensors, read_torch_file

PREFIX = "agent.model."
"""Before every name in a released Lightning checkpoint."""

VOCABULARY = "_trajectory_head.vocab"
"""The training vocabulary inside a checkpoint; it is not part of the model."""

UNUSED = ("_query_embedding.", "_tf_decoder.", "_agent_head.")
"""Beginnings of names that released checkpoints hold and the model never uses."""

_PICKLES = (b"PK\x03\x04", b"\x80")
_MEND = "fetch or write the file anew, or give the sizes it was made with"


def read_weights(path: str | Path) -> dict[str, Tensor]:
    """All tensors of a file by name, without the prefix of released checkpoints, on the CPU.

    A PyTorch file may hold a state dict or have one under "state_dict". Nothing but tensors and
    plain values is unpickled (`weights_only`).

    Raises:
        InputError: the file is missing, cannot be read, or holds other objects.
    """
    path = Path(path)
    with disk_errors(path), path.open("rb") as file:
        pickled = file.read(4).startswith(_PICKLES)
    tensors = _read_pytorch(path) if pickled else read_safetensors(path, "file", _MEND)[0]
    bare = {name.removeprefix(PREFIX): tensor for name, tensor in tensors.items()}
    if len(bare) < len(tensors):
        raise InputError(
            path, PREFIX, "stands before some names that are also there without it", _MEND
        )
    return bare


def load_weights(
    model: GtrsModel,
    tensors: Mapping[str, Tensor],
    where: str | Path,
    device: str | torch.device = "cpu",
) -> None:
    """Copy weights into a model, which may be on the meta device; every name and shape must agree.

    Floating-point types are converted to the model's. The vocabulary and the unused modules of
    released checkpoints are passed over. Afterwards the model is on `device` and in evaluation
    mode.

    Raises:
        InputError: a tensor is missing, unexpected, of another shape or kind, or not finite. The
            line names the first and counts all.
    """
    given = {k: v for k, v in tensors.items() if k != VOCABULARY and not k.startswith(UNUSED)}
    wanted = model.state_dict()
    both = sorted(given.keys() & wanted.keys())
    faults: dict[str, dict[str, str]] = {
        "of another shape": {
            name: f"has shape {_shape(given[name])}, the model {_shape(wanted[name])}"
            for name in both
            if given[name].shape != wanted[name].shape
        },
        "missing": dict.fromkeys(sorted(wanted.keys() - given.keys()), "is missing"),
        "unexpected": dict.fromkeys(sorted(given.keys() - wanted.keys()), "is not expected"),
        "of another type": {
            name: f"holds {given[name].dtype}, the model {wanted[name].dtype}"
            for name in both
            if given[name].is_floating_point() != wanted[name].is_floating_point()
        },
    }
    if not any(faults.values()):
        faults["not finite"] = {
            name: "holds NaN or infinite values"
            for name in both
            if not bool(torch.isfinite(given[name]).all())
        }
    first = next((item for fault in faults.values() for item in fault.items()), None)
    if first is not None:
        counts = ", ".join(f"{len(fault)} {kind}" for kind, fault in faults.items() if fault)
        raise InputError(where, first[0], f"{first[1]} ({counts})", _MEND)
    if model.device.type == "meta":
        model.to_empty(device=device)
    model.to(device).load_state_dict(given)
    model.eval()


def _read_pytorch(path: Path) -> dict[str, Tensor]:
    content = read_torch_file(path, _MEND)
    if isinstance(content, Mapping) and isinstance(content.get("state_dict"), Mapping):
        content = content["state_dict"]
    if not isinstance(content, Mapping) or not content:
        raise InputError(path, "state_dict", "is missing", "give a Lightning or PyTorch checkpoint")
    for name, value in content.items():
        if not isinstance(name, str) or not isinstance(value, Tensor):
            raise InputError(
                path, str(name), f"is {type(value).__name__}, not a tensor",
                "give a Lightning or PyTorch checkpoint",
            )  # fmt: skip
    return dict(content)


def _shape(tensor: Tensor) -> tuple[int, ...]:
    return tuple(tensor.shape)
