"""Everything that a stage needs, opened and checked before the first step."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from recast.core.errors import InputError
from recast.recar.targets import TargetCache
from recast.recar.training.conditions import (
    ConditionSource,
    SetConditions,
    missing_pictures,
    open_conditions,
)
from recast.recar.training.output import StageInputs, hash_files, model_paths
from recast.recar.training.stage_config import FlowName, StageConfig
from recast.recar.vehicle_set import SET_FILE
from recast.training.loop import Processes
from recast.trellis import ImageTo3D

_SHOWN = 3


@dataclass(frozen=True)
class StageRequest:
    """What is trained, from what, into which folder.

    Attributes:
        config: configuration of the stage.
        model: folder in the published layout that training starts from.
        targets: cache of targets.
        pictures: vehicle set, or folder of training assets.
        out: folder of the new model; one of the same training is continued.
        image_encoder: weights of the published encoder, where `model` has none.
        device: device such as "cuda:0"; None takes CUDA where there is some.
        tensorboard: whether to write curves into OUT/tensorboard too.
        flows: flows to train now; all of the stage where none is named. Several processes can each
            train one; the last to finish writes the model.
    """

    config: StageConfig
    model: Path
    targets: Path
    pictures: Path
    out: Path
    image_encoder: Path | None = None
    device: str | None = None
    tensorboard: bool = False
    flows: tuple[FlowName, ...] = ()


@dataclass(frozen=True)
class StageParts:
    """A request that was opened.

    Attributes:
        model: all networks, in float32.
        train, held_out: vehicles with a target that is used.
        unscreened: number of vehicles in `train` that no person decided about; None where they
            are no pseudo-targets, since the pictures are those of training assets.
    """

    model: ImageTo3D
    targets: TargetCache
    pictures: ConditionSource
    train: tuple[str, ...]
    held_out: tuple[str, ...]
    unscreened: int | None
    inputs: StageInputs


def open_stage(request: StageRequest, processes: Processes) -> StageParts:
    """Open model, targets and pictures, and check that they belong together.

    Raises:
        InputError: one of them is missing or broken, targets are of another size than the model
            makes, a target has no picture, a vehicle is in both splits, or a flow is asked for
            that the stage does not train.
    """
    config = request.config
    for flow in request.flows:
        if flow not in config.settings:
            raise InputError(
                "`flow`", flow, f"is not trained by {config.name}", "choose another flow"
            )
    for name, settings in config.settings.items():
        parts = settings.accumulate * processes.count
        if parts > config.objective.batch:
            raise InputError(
                "stage",
                "objective.batch",
                f"is {config.objective.batch}, less than {parts} parts of {name} "
                f"({processes.count} processes, accumulate {settings.accumulate})",
                "raise it, or use fewer processes",
            )
    targets = TargetCache.open(request.targets)
    pictures = open_conditions(request.pictures)
    train, held_out = targets.ids("train"), targets.ids("held-out")
    decisions = pictures.decisions if isinstance(pictures, SetConditions) else {}
    left_out = {name for name, decision in decisions.items() if decision == "no"}
    train = tuple(one for one in train if one not in left_out)
    held_out = tuple(one for one in held_out if one not in left_out)
    _check_pictures(request, pictures, train, held_out)
    device = processes.device or request.device
    model = ImageTo3D.load(
        request.model,
        device=None if device is None else str(device),
        torso_dtype=torch.float32,
        image_encoder=request.image_encoder,
    )
    if config.train_encoder and model.checkpoint.record.encoder_role is None:
        raise InputError(
            request.model,
            "image encoder",
            "is the published one, which cannot be trained",
            "set train_encoder to false",
        )
    _check_sizes(request, model, targets, (*train, *held_out))
    inputs = StageInputs(
        config=config,
        model=request.model.resolve().name,
        model_sha256=hash_files(request.model, model_paths(request.model, model.checkpoint.record)),
        targets=request.targets.resolve().name,
        targets_sha256=_targets_hash(targets),
        pictures=request.pictures.resolve().name,
        pictures_sha256=_pictures_hash(request.pictures, left_out),
        train=len(train),
        held_out=len(held_out),
    )
    unscreened = None
    if isinstance(pictures, SetConditions):
        unscreened = sum(one not in {**targets.decisions, **decisions} for one in train)
    return StageParts(model, targets, pictures, train, held_out, unscreened, inputs)


def _check_pictures(
    request: StageRequest, pictures: ConditionSource, train: Sequence[str], held_out: Sequence[str]
) -> None:
    missing = missing_pictures(pictures, (*train, *held_out))
    if missing:
        raise InputError(
            request.pictures,
            "pictures",
            f"{len(missing)} vehicles with a target have no images: {_listed(missing)}",
            "give the set that the targets were made from",
        )
    if isinstance(pictures, SetConditions):
        wrong = tuple(one for one in train if pictures.split(one) != "train")
        wrong += tuple(one for one in held_out if pictures.split(one) != "held-out")
        if wrong:
            raise InputError(
                request.targets,
                "split",
                f"of {len(wrong)} vehicles differs from that of the set: {_listed(wrong)}",
                "make the targets again from this set",
            )


def _check_sizes(
    request: StageRequest, model: ImageTo3D, targets: TargetCache, identities: Sequence[str]
) -> None:
    latent: Any = model.latent_flow.config
    if targets.record.model.resolution != latent.resolution:
        raise InputError(
            request.targets,
            "resolution",
            f"of the targets is {targets.record.model.resolution}, but the model makes "
            f"{latent.resolution}",
            "make the targets with a model of the same size",
        )
    for identity in identities[:1]:
        one = targets.target(identity)
        found = [*one.structure.shape, one.latent.shape[1]]
        expected = [*model.structure_shape, model.latent_channels]
        if found != expected:
            raise InputError(
                request.targets,
                identity,
                f"has structure and latent of {found}, but the model makes {expected}",
                "make the targets with a model of the same size",
            )


def _targets_hash(targets: TargetCache) -> str:
    """Of what says which targets there are; latents follow from it."""
    folder = targets.folder
    files = [*folder.glob("*.json"), *folder.glob("records/[!.]*.json")]
    left_out = {name for name, decision in targets.decisions.items() if decision == "no"}
    return _with_names(hash_files(folder, files), left_out)


def _pictures_hash(folder: Path, left_out: Set[str]) -> str:
    """Of the records of a set; assets, which have none, are read whole."""
    records = [folder / SET_FILE, *folder.glob("[!.]*/identity.json")]
    found = [path for path in records if path.is_file()]
    return _with_names(hash_files(folder, found or folder.glob("[!.]*.npz")), left_out)


def _with_names(digest: str, left_out: Set[str]) -> str:
    # Of the decisions only: notes may be written into screening.csv while a stage is in training.
    return (
        hashlib.sha256(" ".join([digest, *sorted(left_out)]).encode()).hexdigest()
        if left_out
        else digest
    )


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more
