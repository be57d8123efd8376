"""How the flows are trained in one stage: every figure, with the paper's as presets."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from recast.errors import InputError
from recast.recar.perturb import PerturbationConfig
from recast.recar.training.settings import TrainerSettings
from recast.records import validation_error
from recast.storage import read_json

FlowName = Literal["structure", "latent"]
FLOWS: tuple[FlowName, ...] = ("structure", "latent")


class FlowObjective(BaseModel):
    """What is learnt from a batch.

    Attributes:
        batch: vehicles a step, over all processes and accumulated parts together.
        condition_drop: probability for a sample to lose its condition.
        time_mean, time_std: of the normal numbers whose logistic function gives the times.
        sigma_min: noise left at t = 0.
        autocast: compute in this type on CUDA, with weights, moments and averages in float32; a
            CPU computes in float32 in any case.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    batch: int = Field(default=2, ge=1)
    condition_drop: float = Field(default=0.1, ge=0, le=1)
    time_mean: float = 1.0
    time_std: float = Field(default=1.0, gt=0)
    sigma_min: float = Field(default=1e-5, ge=0, lt=1)
    autocast: Literal["bfloat16"] | None = "bfloat16"


class StageConfig(BaseModel):
    """One stage.

    Attributes:
        name: for people.
        structure, latent: how each flow is trained; None leaves it as it is.
        objective: of both.
        perturbation: alters the pictures of conditions; {} in a file takes all defaults, None
            leaves all clean.
        train_encoder: train the image encoder together with the structure flow, instead of
            keeping it frozen; for small models, whose encoder nothing has trained before.
        checkpointing: recompute activations in the backward pass to save memory.
        weights: what is written into the new model: the moving average, or the latest weights.
        token_memory_mib: bound on the tokens of clean pictures that are kept in memory.
        probe: held-out vehicles on which the gap between true and shuffled conditions is measured
            with every line of the log; 0 for none.
        sheet_every: steps between sample sheets; 0 for none.
        sheet_vehicles: held-out vehicles on them.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

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
                    f"{name}: a batch of {self.objective.batch} accumulated in "
                    f"{settings.accumulate} parts"
                )
            if self.weights == "average" and settings.ema_decay is None:
                raise ValueError(f"{name}: weights are the average, but ema_decay is null")
        if self.train_encoder and self.structure is None:
            raise ValueError("train_encoder: the encoder trains with the structure flow")
        return self

    @property
    def settings(self) -> dict[FlowName, TrainerSettings]:
        """How each flow that is trained is trained, the structure first."""
        pairs: tuple[tuple[FlowName, TrainerSettings | None], ...] = (
            ("structure", self.structure), ("latent", self.latent),
        )  # fmt: skip
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
    structure=_trainer(6_000, 1e-3, schedule="cosine", warmup=200, ema_decay=0.998),
    latent=_trainer(6_000, 1e-3, schedule="cosine", warmup=200, ema_decay=0.998),
    objective=FlowObjective(batch=8),
    checkpointing=False,
)
"""A small model whose image encoder was trained before and stays as it is."""

PRESETS: Mapping[str, StageConfig] = {one.name: one for one in (STAGE_1, STAGE_2, BASE)}


def read_stage_config(path: Path) -> StageConfig:
    """Read a JSON file: all members of a `StageConfig`, or "preset" and what differs from it.

    Raises:
        InputError: no such file or preset, a member unknown or out of range.
    """
    mend = "see docs/recar.md, section Training"
    values = read_json(path)
    if not isinstance(values, dict):
        raise InputError(path, "JSON", "is no object", mend)
    preset = values.pop("preset", None)
    if preset is not None and preset not in PRESETS:
        raise InputError(path, "preset", f"is {preset!r}", f"take one of {', '.join(PRESETS)}")
    start = {} if preset is None else PRESETS[preset].model_dump(mode="json")
    try:
        return StageConfig.model_validate(_merged(start, values))
    except ValidationError as error:
        raise validation_error(path, error, mend) from None


def _merged(start: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Members replaced; objects member by member."""
    merged = dict(start)
    for name, value in changes.items():
        old = merged.get(name)
        both = isinstance(old, Mapping) and isinstance(value, Mapping)
        merged[name] = _merged(old, value) if both else value  # type: ignore[arg-type]
    return merged


def chosen_stage(stage: str | None, file: Path | None) -> StageConfig:
    """The stage that a command names: "1", "2" or "base", or a file; exactly one of them.

    Args:
        stage: the name.
        file: see `read_stage_config`.

    Raises:
        InputError: none or both are given, or the file is wrong.
    """
    if (stage is None) == (file is None):
        raise InputError(
            "--stage", "value", "neither it nor --config is given" if stage is None else
            "--config is given too", "give one of the two",
        )  # fmt: skip
    if file is not None:
        return read_stage_config(file)
    return PRESETS[f"stage-{stage}" if stage in ("1", "2") else str(stage)]
