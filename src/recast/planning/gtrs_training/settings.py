"""The small planner's sizes, pictures and first weights, and how it is trained.

Any figure of the training can be overridden from a file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from pydantic import Field, ValidationError

from recast.core.errors import InputError
from recast.core.files import read_json
from recast.core.records import Record, validation_error
from recast.planning.gtrs import (
    BackboneConfig,
    GtrsConfig,
    GtrsModel,
    ScoreWeights,
    StageConfig,
    new_model,
)
from recast.planning.gtrs.views import ViewLayout
from recast.recar.training.task import TrainerSettings

NAME = "gtrs-mini"

MINI_VIEWS = ViewLayout(
    width=480, height=320, crop_rows=32, crop_columns=104, input_width=512, input_height=128
)
"""Three cameras of the synthetic rig in the loop: 272 + 480 + 272 columns, averaged two by two."""

HALF_VIEWS = ViewLayout(
    width=240, height=160, crop_rows=16, crop_columns=52, input_width=512, input_height=128
)
"""The same rendered at half the size, for the training: a quarter of the cost."""


def _stage(blocks: int, conv_channels: int, out_channels: int) -> StageConfig:
    return StageConfig(blocks=blocks, conv_channels=conv_channels, out_channels=out_channels)


MINI = GtrsConfig(
    backbone=BackboneConfig(
        stem=(16, 16, 32),
        stages=(_stage(1, 24, 48), _stage(1, 48, 96), _stage(3, 64, 192)),
        layers=3,
        frozen_norm=False,
    ),
    channels=128,
    feedforward=192,
    heads=4,
    decoder_layers=2,
    token_rows=8,
    token_columns=32,
)
"""A backbone that ends at stride 16: a vehicle 40 m ahead is 11 of 512 columns wide."""

MINI_SCORING = ScoreWeights(
    imitation=0.03,
    no_collision=4.0,
    drivable_area=2.0,
    direction=0.2,
    traffic_light=0.1,
    average=6.0,
    time_to_collision=10.0,
    progress=7.0,
    lane_keeping=6.0,
)
"""Weights of the final score, chosen on held-out samples of training worlds, as the published
ones were on a validation set: a small network is less sure, and collisions weigh more."""

_USUAL = {
    "no_at_fault_collisions": 1.0,
    "drivable_area_compliance": 1.0,
    "traffic_light_compliance": 5.0,
}
"""Logits that the heads begin with, where most trajectories are fine."""


def first_model(seed: int, config: GtrsConfig = MINI) -> GtrsModel:
    """The network before its first step; the vocabulary embedding is scaled to metres."""
    model = new_model(config, torch.Generator().manual_seed(seed))
    with torch.no_grad():
        # Raw metres come in, tens of them: unit weights would drown all else in a few entries.
        first = model.head.pos_embed[0]
        assert isinstance(first, torch.nn.Linear)
        first.weight.mul_(0.1)
        for name, logit in _USUAL.items():
            last = model.head.heads[name][-1]  # type: ignore[index]
            last.bias.fill_(logit)
    return model


class PlannerTrainingConfig(Record):
    """How the planner is trained; the defaults are the shipped one's.

    Attributes:
        trainer: optimiser and schedule.
        network: sizes.
        scoring: of the exported planner, by which it is judged too.
        batch: samples a step, even.
        kept: trajectories of the vocabulary that are scored in a step.
        judged: held-out samples that each line of the log is judged on; at the end all are.
        sheet_every: steps between sheets of held-out decisions; 0 draws none.
    """

    trainer: TrainerSettings = TrainerSettings(
        steps=4_800,
        lr=6e-4,
        schedule="cosine",
        warmup=300,
        ema_decay=0.998,
        clip=2.0,
        checkpoint_every=250,
        log_every=250,
    )
    network: GtrsConfig = MINI
    scoring: ScoreWeights = MINI_SCORING
    batch: int = Field(default=8, ge=2, multiple_of=2)
    kept: int = Field(default=192, ge=1)
    judged: int = Field(default=96, ge=2)
    sheet_every: int = Field(default=2_000, ge=0)


def chosen_training(
    path: Path | None, seed: int = 0, steps: int | None = None
) -> PlannerTrainingConfig:
    """The shipped planner's settings, with what a JSON file and the arguments say instead.

    Raises:
        InputError: the file is missing, no JSON object, or names what does not exist.
    """
    chosen: dict[str, Any] = PlannerTrainingConfig().model_dump(mode="json")
    if path is not None:
        said = read_json(path)
        if not isinstance(said, dict):
            raise InputError(path, "JSON", "is no object", "write what differs, by name")
        _override(chosen, said)
    chosen["trainer"]["seed"] = seed
    if steps is not None:
        chosen["trainer"]["steps"] = steps
    try:
        return PlannerTrainingConfig.model_validate(chosen)
    except ValidationError as error:
        raise validation_error(path or "--steps", error, "see the defaults") from None


def _override(chosen: dict[str, Any], said: dict[str, Any]) -> None:
    for name, value in said.items():
        if isinstance(value, dict) and isinstance(chosen.get(name), dict):
            _override(chosen[name], value)
        else:
            chosen[name] = value
