"""A GTRS planner as a folder: `config.json`, `weights.safetensors`, `vocabulary.npy`."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import torch
from pydantic import Field
from safetensors.torch import save

from recast.errors import InputError
from recast.planning.gtrs.config import GtrsConfig
from recast.planning.gtrs.model import empty_model
from recast.planning.gtrs.planner import GtrsPlanner
from recast.planning.gtrs.scores import VOCABULARY_ONLY, ScoreWeights
from recast.planning.gtrs.views import WAYMO_NATIVE, ViewLayout
from recast.planning.gtrs.vocabulary import check_vocabulary, read_vocabulary, write_vocabulary
from recast.planning.gtrs.weights import VOCABULARY, load_weights, read_weights
from recast.records import Record, read_record
from recast.storage import atomic_folder, write_bytes, write_json

CONFIG_FILE = "config.json"
WEIGHTS_FILE = "weights.safetensors"
VOCABULARY_FILE = "vocabulary.npy"

_MEND = "write the folder anew with save_gtrs"


class _Config(Record):
    """`config.json`."""

    format: Literal["recast-gtrs"]
    version: Literal[1]
    name: str = Field(pattern=r"^[\w.+-]+$")  # stands in file names
    model: GtrsConfig
    views: ViewLayout
    scoring: ScoreWeights


def save_gtrs(folder: str | Path, planner: GtrsPlanner, dtype: torch.dtype = torch.float32) -> None:
    """Write a planner as a folder, whole or not at all. The same weights give the same bytes.

    Args:
        folder: new.
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
    config = read_record(folder / CONFIG_FILE, _Config, 1, _MEND, "recast-gtrs")
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
        views: which cameras, and how they are stitched.
        config: sizes; None for the released ones.
        name: for tables and messages.

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
