"""Writes the trained model: a folder in the published layout, other roles as they were."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import torch

from recast.storage import atomic_file, write_bytes
from recast.trellis.checkpoints import PipelineRecord, save_model
from recast.trellis.checkpoints.backbone import BACKBONE_FOLDER
from recast.trellis.checkpoints.record import PIPELINE_FILE
from recast.trellis.models import TrellisModel


def model_paths(folder: Path, record: PipelineRecord) -> list[Path]:
    """`pipeline.json` and the files of all models of a folder that are there."""
    stems = [folder / stem for stem in record.models.values()]
    files = [s.parent / f"{s.name}{end}" for s in stems for end in (".json", ".safetensors")]
    return [folder / PIPELINE_FILE, *(path for path in files if path.is_file())]


def write_trained_model(
    source: Path, out: Path, record: PipelineRecord, trained: Mapping[str, TrellisModel]
) -> None:
    """Write trained models by role, and copy everything else that a model folder holds.

    `pipeline.json` comes last, so that a folder cut short is no model. Weights have the precision
    that the source's had.

    Raises:
        InputError: the disk is full.
    """
    stems = {out / record.models[role] for role in trained}
    for path in model_paths(source, record)[1:]:
        target = out / path.relative_to(source)
        if target.parent / path.stem not in stems:
            _copy(path, target)
    backbone = source / BACKBONE_FOLDER
    for path in sorted(backbone.rglob("*")) if backbone.is_dir() else []:
        if path.is_file():
            _copy(path, out / path.relative_to(source))
    for role, model in trained.items():
        model.set_torso_dtype(torch.float16 if model.config.use_fp16 else torch.float32)
        save_model(out / record.models[role], model)
    write_bytes(out / PIPELINE_FILE, (source / PIPELINE_FILE).read_bytes())


def _copy(source: Path, target: Path) -> None:
    with atomic_file(target) as partial:
        shutil.copyfile(source, partial)
