"""The two files of a model: `<stem>.json` (class and arguments) and `<stem>.safetensors`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from recast.errors import InputError
from recast.records import validation_error
from recast.storage import read_json
from recast.trellis.checkpoints.check import ModelCheck
from recast.trellis.checkpoints.classes import MODEL_CLASSES
from recast.trellis.checkpoints.header import read_header
from recast.trellis.checkpoints.layout import tensor_specs
from recast.trellis.checkpoints.record import PIPELINE_FILE, PipelineRecord
from recast.trellis.models import TrellisModel, build


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
                folder / PIPELINE_FILE, f"models.{role}",
                f"names {stem}, but {path.relative_to(folder)} is not in the folder",
                "put the model's files there, or correct the path",
            )  # fmt: skip
    return files
