"""Writes models as a folder in the published layout."""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import save_file
from torch import Tensor

from recast.errors import InputError
from recast.storage import atomic_folder, write_json
from recast.trellis.checkpoints.record import PIPELINE_FILE, PipelineRecord, write_pipeline
from recast.trellis.models.base import TrellisModel


def save_checkpoint(
    folder: str | Path, record: PipelineRecord, models: Mapping[str, TrellisModel]
) -> None:
    """Write `pipeline.json` and both files of every model, whole or not at all.

    The same weights give the same bytes. Element types are kept, but for bfloat16, which the
    published layout does not know: it is written as float32, without loss.

    Args:
        folder: new.
        record: names the path of each model by role. Roles without a model stay named, as in the
            published checkpoints, whose parts are fetched as needed.
        models: by role.

    Raises:
        InputError: the folder exists, the disk is full, the record does not name a role, or two
            roles have the same path.
    """
    for role in models:
        if role not in record.models:
            raise InputError(PIPELINE_FILE, f"models.{role}", "is missing", "name the model's path")
    stems = [record.models[role] for role in models]
    if len(set(stems)) != len(stems):
        raise InputError(
            PIPELINE_FILE, "models", "name the same path twice", "give each role its own"
        )
    with atomic_folder(folder) as partial:
        write_pipeline(partial, record)
        for role, model in models.items():
            save_model(partial / record.models[role], model)


def save_model(stem: Path, model: TrellisModel) -> None:
    """Write `<stem>.json` (class and arguments) and `<stem>.safetensors` (weights)."""
    tensors = {name: _storable(tensor) for name, tensor in model.published_state().items()}
    # Arguments that were not given are left out: other readers may not know all of ours.
    args = model.config.model_dump(
        mode="json", by_alias=True, exclude={"use_fp16"}, exclude_unset=True
    )
    if model.torso:
        args["use_fp16"] = any(tensor.dtype == torch.float16 for tensor in tensors.values())
    stem.parent.mkdir(parents=True, exist_ok=True)
    # Not with_suffix: stems may hold dots.
    write_json(stem.parent / f"{stem.name}.json", {"name": model.published_name, "args": args})
    try:
        save_file(tensors, stem.parent / f"{stem.name}.safetensors")
    except SafetensorError as error:
        if f"os error {errno.ENOSPC}" in str(error):  # said by safetensors in its own way
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) from error
        raise


def _storable(tensor: Tensor) -> Tensor:
    tensor = tensor.detach().cpu()
    return (tensor.float() if tensor.dtype == torch.bfloat16 else tensor).contiguous()
