"""How the small planner is trained; any figure can be overridden from a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from recast.errors import InputError
from recast.planning.gtrs import GtrsConfig, ScoreWeights
from recast.planning.gtrs_training.network import MINI, MINI_SCORING
from recast.recar.training.settings import TrainerSettings
from recast.records import Record, validation_error
from recast.storage import read_json


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
        steps=4_800, lr=6e-4, schedule="cosine", warmup=300, ema_decay=0.998, clip=2.0,
        checkpoint_every=250, log_every=250,
    )  # fmt: skip
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
