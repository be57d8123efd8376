"""Makers of targets in a crew of workers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch

from recast.recar.targets.maker import Job, Outcome, TargetMaker
from recast.recar.targets.model_source import ModelSource
from recast.recar.targets.settings import TargetSettings


def start_maker(
    number: int, source: ModelSource, settings: TargetSettings
) -> Callable[[Job], Outcome]:
    """What worker `number` makes targets with; CUDA devices go round where none is named."""
    device = source.device
    if device is None and torch.cuda.is_available():
        device = f"cuda:{number % torch.cuda.device_count()}"
    return TargetMaker.load(source, settings, device).make


def absolute(source: ModelSource, settings: TargetSettings) -> tuple[ModelSource, TargetSettings]:
    """The same with paths that do not depend on the working folder, which is another on a cluster.

    The model folder must lie under the same path on every machine of it.
    """

    def path(given: Path | None) -> Path | None:
        return None if given is None else given.absolute()

    judge = settings.filter
    files = {"predictor": path(judge.predictor), "clip": path(judge.clip)}
    return (
        replace(source, folder=source.folder.absolute(), image_encoder=path(source.image_encoder)),
        settings.model_copy(update={"filter": judge.model_copy(update=files)}),
    )
