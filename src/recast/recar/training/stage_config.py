"""How the flows are trained in one stage: every figure, those of the paper, and files of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, FiniteFloat, ValidationError, model_validator

from recast.core.errors import InputError
from recast.core.files import read_json
from recast.core.records import Record, validation_error
from recast.recar.perturb import PerturbationConfig
from recast.training.task import TrainerSettings, overridden

FlowName = Literal["structure", "latent"]


class FlowObjective(Record):
    """What is learnt from a batch.

    Attributes:
        batch: vehicles a step, over all processes and accumulated parts together.
        condition_drop: probability for a sample to lose its condition.
        time_mean, time_std: mean and standard deviation of the normal numbers whose logistic
            function gives the times.
        sigma_min: noise left at t = 0.
        autocast: compute in this type on CUDA, with weights, moments and averages in float32; a
            CPU computes in float32 in any case.
    """

    batch: int = Field(default=2, ge=1, le=65536)
    condition_drop: float = Field(default=0.1, ge=0, le=1)
    time_mean: FiniteFloat = 1.0
    time_std: FiniteFloat = Field(default=1.0, gt=0)
    sigma_min: float = Field(default=1e-5, ge=0, lt=1)
    autocast: Literal["bfloat16"] | None = "bfloat16"


class StageConfig(Record):
    """One stage.

    Attributes:
        name: name for people.
        structure, latent: settings with which each flow is trained; None leaves it as it is.
        objective: objective of both flows.
        perturbation: perturbation of the pictures of conditions; {} in a file takes all defaults,
            None leaves all clean.
        train_encoder: train the image encoder together with the structure flow, instead of
            keeping it frozen; for small models, whose encoder nothing has trained before.
        checkpointing: recompute activations in the backward pass to save memory.
        weights: weights that are written into the new model: the moving average, or the latest
            weights.
        token_memory_mib: bound on the tokens of clean pictures that are kept in memory.
        probe: number of held-out vehicles on which the gap between true and shuffled conditions is
            measured with every line of the log; 0 for none.
        sheet_every: number of steps between sample sheets; 0 for none.
        sheet_vehicles: number of held-out vehicles on them.
    """

    name: str
    structure: TrainerSettings | None
    latent: TrainerSettings | None
    objective: FlowObjective = FlowObjective()
    perturbation: PerturbationConfig | None = None
    train_encoder: bool = False
    checkpointing: bool = True
    weights: Literal["average", "raw"] = "average"
    token_memory_mib: int = Field(default=1024, ge=0)
    probe: int = Field(default=8, ge=0)
    sheet_every: int = Field(default=1000, ge=0)
    sheet_vehicles: int = Field(default=4, ge=1)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for name, settings in self.settings.items():
            if self.objective.batch < settings.accumulate:
                raise ValueError(
                    f"{name}: a batch of {self.objective.batch} does not split into "
                    f"{settings.accumulate} parts"
                )
            if self.weights == "average" and settings.ema_decay is None:
                raise ValueError(f"{name}: weights are the average, but ema_decay is null")
        if self.train_encoder and self.structure is None:
            raise ValueError("train_encoder: the encoder can only train with the structure flow")
        return self

    @property
    def settings(self) -> dict[FlowName, TrainerSettings]:
        """How each flow that is trained is trained, the structure first."""
        pairs: tuple[tuple[FlowName, TrainerSettings | None], ...] = (
            ("structure", self.structure),
            ("latent", self.latent),
        )
        return {name: settings for name, settings in pairs if settings is not None}


def _trainer(steps: int, lr: float, **changes: Any) -> TrainerSettings:
    fields = {"ema_decay": 0.9999, "checkpoint_every": 500, "log_every": 50} | changes
    return TrainerSettings.model_validate({"steps": steps, "lr": lr, **fields})


STAGE_1 = StageConfig(
    name="stage-1", structure=_trainer(10_000, 1e-5), latent=_trainer(16_000, 1e-5)
)
"""Vehicles (paper, section 2): clean pictures, towards the pseudo-targets."""

STAGE_2 = StageConfig(
    name="stage-2",
    structure=_trainer(12_000, 2e-6),
    latent=_trainer(12_000, 2e-6),
    perturbation=PerturbationConfig(),
)
"""Robustness (paper, section 2): the same targets, four pictures in five perturbed."""

BASE = StageConfig(
    name="base",
    structure=_trainer(9_000, 1e-3, schedule="cosine", warmup=400, ema_decay=0.999),
    latent=_trainer(3_000, 1e-3, schedule="cosine", warmup=200, ema_decay=0.998),
    objective=FlowObjective(batch=4),
    checkpointing=False,
)
"""The small model before its adaptation; its image encoder was trained before and stays."""

BASE_2 = BASE.model_copy(
    update={
        "name": "base-2",
        "structure": _trainer(12_000, 8e-4, schedule="cosine", warmup=200, ema_decay=0.999),
        "latent": _trainer(4_800, 1e-3, schedule="cosine", warmup=100, ema_decay=0.998),
    }
)
"""A second round of the base, from the weights of the first."""

_MINI = STAGE_1.model_copy(update={"objective": FlowObjective(batch=4), "checkpointing": False})

MINI_STAGE_1 = _MINI.model_copy(
    update={
        "name": "mini-stage-1",
        "structure": _trainer(2_500, 3e-4, schedule="cosine", warmup=50, ema_decay=0.998),
        "latent": _trainer(1_000, 3e-4, schedule="cosine", warmup=50, ema_decay=0.998),
    }
)
"""Stage I of the small model: higher rates and fewer steps than those of half a billion weights."""

MINI_STAGE_2 = MINI_STAGE_1.model_copy(
    update={"name": "mini-stage-2", "perturbation": STAGE_2.perturbation}
)
"""Stage II of the small model."""

PRESETS: Mapping[str, StageConfig] = {
    one.name: one for one in (STAGE_1, STAGE_2, BASE, BASE_2, MINI_STAGE_1, MINI_STAGE_2)
}
COMMAND_NAMES: Mapping[str, StageConfig] = {
    "1": STAGE_1,
    "2": STAGE_2,
    "base": BASE,
    "base-2": BASE_2,
    "mini-1": MINI_STAGE_1,
    "mini-2": MINI_STAGE_2,
}
"""What `stage` takes."""


def read_stage_config(path: Path) -> StageConfig:
    """Read a JSON file: all members of a `StageConfig`, or "preset" and what differs from it.

    Raises:
        InputError: no such file or preset, a member unknown or out of range.
    """
    mend = "correct it; see docs/recar.md#training"
    values = read_json(path)
    if not isinstance(values, dict):
        raise InputError(path, "JSON", "is not an object", mend)
    preset = values.pop("preset", None)
    if preset is not None and preset not in PRESETS:
        raise InputError(path, "preset", f"is {preset!r}", f"use one of {', '.join(PRESETS)}")
    start = {} if preset is None else PRESETS[preset].model_dump(mode="json")
    try:
        return StageConfig.model_validate(overridden(start, values))
    except ValidationError as error:
        raise validation_error(path, error, mend) from None


def chosen_stage(stage: str | None, file: Path | None) -> StageConfig:
    """The stage that a command names, or a file; exactly one of them.

    Args:
        stage: name of the stage, one of `COMMAND_NAMES`.
        file: file of the stage, see `read_stage_config`.

    Raises:
        InputError: none or both are given, or the file is wrong.
    """
    if (stage is None) == (file is None):
        raise InputError(
            "`stage`",
            "value",
            "is missing, and so is `config`"
            if stage is None
            else "is given together with `config`",
            "give one of the two",
        )
    if file is not None:
        return read_stage_config(file)
    return COMMAND_NAMES[str(stage)]
