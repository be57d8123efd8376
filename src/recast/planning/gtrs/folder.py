"""A GTRS planner as a folder: `config.json`, `weights.safetensors`, `vocabulary.npy`.

Released Lightning checkpoints are read too; weights are loaded strictly.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import torch
from pydantic import Field
from safetensors.torch import save
from torch import Tensor

from recast.core.errors import InputError
from recast.core.files import atomic_folder, disk_errors, write_bytes, write_json
from recast.core.records import Record, read_record
from recast.core.torch_file import read_safetensors, read_torch_file, require_state
from recast.planning.gtrs.config import WAYMO_NATIVE, GtrsConfig, ViewLayout
from recast.planning.gtrs.model import GtrsModel, empty_model
from recast.planning.gtrs.planner import GtrsPlanner
from recast.planning.gtrs.scores import (
    VOCABULARY_ONLY,
    ScoreWeights,
    check_vocabulary,
    read_vocabulary,
    write_vocabulary,
)

PREFIX = "agent.model."
"""Before every name in a released Lightning checkpoint."""

VOCABULARY = "_trajectory_head.vocab"
"""The training vocabulary inside a checkpoint; it is not part of the model."""

UNUSED = ("_query_embedding.", "_tf_decoder.", "_agent_head.")
"""Beginnings of names that released checkpoints hold and the model never uses."""

_PICKLES = (b"PK\x03\x04", b"\x80")
_MEND = "download or write the file again, or give the network sizes that it was made with"
CONFIG_FILE = "config.json"
WEIGHTS_FILE = "weights.safetensors"
VOCABULARY_FILE = "vocabulary.npy"

_MEND_FOLDER = "write the folder again with save_gtrs"
CHECKPOINT, VOCABULARY_OF_RELEASE, PLANNER = "gtrs_dense_vov.ckpt", "8192.npy", "planner"


class _Config(Record):
    """`config.json`."""

    format: Literal["recast-gtrs"]
    version: Literal[1]
    name: str = Field(pattern=r"^[\w.+~-]+$")  # stands in file names
    model: GtrsConfig
    views: ViewLayout
    scoring: ScoreWeights


def save_gtrs(folder: str | Path, planner: GtrsPlanner, dtype: torch.dtype = torch.float32) -> None:
    """Write a planner as a folder, whole or not at all. The same weights give the same bytes.

    Args:
        dtype: floating-point type of the stored weights; float16 halves the file and rounds.

    Raises:
        InputError: the folder exists, or the disk is full.
    """
    config = _Config(
        format="recast-gtrs",
        version=1,
        name=planner.name,
        model=planner.model.config,
        views=planner.views,
        scoring=planner.weights,
    )
    tensors = {
        name: (tensor.to(dtype) if tensor.is_floating_point() else tensor).detach().cpu()
        for name, tensor in planner.model.state_dict().items()
    }
    with atomic_folder(folder) as partial:
        record: dict[str, Any] = config.model_dump(mode="json")
        write_json(partial / CONFIG_FILE, record)
        write_vocabulary(partial / VOCABULARY_FILE, planner.vocabulary)
        # Through bytes: safetensors' own writer reports a full disk in a way of its own.
        write_bytes(partial / WEIGHTS_FILE, save({k: v.contiguous() for k, v in tensors.items()}))


def load_gtrs(folder: str | Path, device: str | torch.device = "cpu") -> GtrsPlanner:
    """Read a planner that `save_gtrs` wrote.

    Raises:
        InputError: a file is missing or wrong, a member of the configuration is unknown or out of
            range, or the weights do not have the sizes that it says.
    """
    folder = Path(folder)
    config = read_record(folder / CONFIG_FILE, _Config, 1, _MEND_FOLDER, "recast-gtrs")
    vocabulary = read_vocabulary(folder / VOCABULARY_FILE)
    model = empty_model(config.model)
    load_weights(model, read_weights(folder / WEIGHTS_FILE), folder / WEIGHTS_FILE, device)
    return GtrsPlanner(model, vocabulary, config.views, name=config.name, weights=config.scoring)


def load_checkpoint(
    path: str | Path,
    vocabulary: str | Path | None = None,
    views: ViewLayout = WAYMO_NATIVE,
    *,
    config: GtrsConfig | None = None,
    device: str | torch.device = "cpu",
    name: str = "gtrs-dense",
) -> GtrsPlanner:
    """Read a released GTRS-Dense checkpoint, or weights with the same names as safetensors.

    `save_gtrs` makes a folder of it that needs no pickle any more.

    Args:
        path: Lightning checkpoint (`.ckpt`), state dict (`.pth`) or safetensors.
        vocabulary: `.npy` file, such as the released 8192 trajectories; None takes those in the
            checkpoint, with which it was trained.
        config: sizes; None for the released ones.
        name: name of the planner, for tables and messages.

    Raises:
        InputError: see `read_weights`, `load_weights` and `read_vocabulary`; or no vocabulary is
            given and the checkpoint has none.
    """
    tensors = read_weights(path)
    if vocabulary is not None:
        trajectories = read_vocabulary(vocabulary)
    elif VOCABULARY in tensors:
        trajectories = check_vocabulary(path, tensors[VOCABULARY])
    else:
        raise InputError(path, VOCABULARY, "is missing", "give a vocabulary file")
    model = empty_model(config or GtrsConfig())
    load_weights(model, tensors, path, device)
    return GtrsPlanner(model, trajectories, views, name=name, weights=VOCABULARY_ONLY)


def convert_release(folder: Path) -> None:
    """Write `planner/` from the files in a folder; see `load_checkpoint` and `save_gtrs`."""
    planner = load_checkpoint(folder / CHECKPOINT, folder / VOCABULARY_OF_RELEASE)
    shutil.rmtree(folder / PLANNER, ignore_errors=True)  # of a try that was killed
    save_gtrs(folder / PLANNER, planner)


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
            path, PREFIX, "is the prefix of some names that also appear without it", _MEND
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
    require_state(where, given, model.state_dict(), _MEND)
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
                path,
                str(name),
                f"is {type(value).__name__}, not a tensor",
                "give a Lightning or PyTorch checkpoint",
            )
    return dict(content)
