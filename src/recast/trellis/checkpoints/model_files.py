"""A model's two files, `<stem>.json` (class, arguments) and `<stem>.safetensors`: found, written.

Models are written as a folder in the published layout.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from safetensors import SafetensorError
from safetensors.torch import save_file
from torch import Tensor

from recast.core.errors import InputError
from recast.core.files import atomic_folder, read_json, write_json
from recast.core.records import validation_error
from recast.trellis.checkpoints.header import ModelCheck, read_header, tensor_specs
from recast.trellis.checkpoints.record import PIPELINE_FILE, PipelineRecord, write_pipeline
from recast.trellis.conditioning import CompactImageEncoder, Dinov2Encoder
from recast.trellis.models import MODELS
from recast.trellis.models.base import TrellisModel
from recast.trellis.models.registry import build

MODEL_CLASSES: Mapping[str, type[TrellisModel]] = {
    **MODELS,
    Dinov2Encoder.published_name: Dinov2Encoder,
    CompactImageEncoder.published_name: CompactImageEncoder,
}
"""By published name; give it to `recast.trellis.models.build`."""


class ModelRecord(BaseModel):
    """`<stem>.json`: class and constructor arguments of a model."""

    model_config = ConfigDict(frozen=True, strict=True, extra="allow", allow_inf_nan=False)

    name: str = Field(min_length=1)
    args: dict[str, Any]


@dataclass(frozen=True)
class ModelFiles:
    """Where a model of a checkpoint folder lies.

    Attributes:
        role: in `pipeline.json`.
        config: the JSON file.
        weights: the safetensors file.
    """

    role: str
    config: Path
    weights: Path

    def meta_model(self) -> TrellisModel:
        """The model on the meta device: names, shapes and types, no memory.

        Raises:
            InputError: the JSON file is missing or wrong, its class or an argument is unknown.
        """
        try:
            record = ModelRecord.model_validate(read_json(self.config))
        except ValidationError as error:
            raise validation_error(self.config, error, "fetch or write the file anew") from None
        with torch.device("meta"):
            return build(record.name, record.args, self.config, MODEL_CLASSES)

    def check(self, model: TrellisModel) -> ModelCheck:
        """Compare the header of the weights with a model.

        Raises:
            InputError: see `read_header`.
        """
        header = read_header(self.weights)
        return ModelCheck(
            self.role,
            self.weights,
            model.published_name,
            header.specs,
            tensor_specs(model.published_state()),
            header.file_bytes,
            sum(parameter.numel() for parameter in model.parameters()),
        )


def model_files(folder: Path, record: PipelineRecord, role: str) -> ModelFiles:
    """The files of a role; both exist.

    Raises:
        InputError: `pipeline.json` does not name the role, or names files that are not there.
    """
    stem = record.models.get(role)
    if stem is None:
        raise InputError(
            folder / PIPELINE_FILE, f"models.{role}", "is missing", "name the model's path"
        )
    # Not with_suffix: stems may hold dots.
    files = ModelFiles(role, folder / f"{stem}.json", folder / f"{stem}.safetensors")
    for path in (files.config, files.weights):
        if not path.is_file():
            raise InputError(
                folder / PIPELINE_FILE,
                f"models.{role}",
                f"names {stem}, but {path.relative_to(folder)} is not in the folder",
                "put the model's files there, or correct the path",
            )
    return files


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
