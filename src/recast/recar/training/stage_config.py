"""How the flows are trained in one stage: every figure."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, FiniteFloat, model_validator

from recast.recar.perturb import PerturbationConfig
from recast.recar.training.settings import TrainerSettings
from recast.records import Record

FlowName = Literal["structure", "latent"]
FLOWS: tuple[FlowName, ...] = ("structure", "latent")


class FlowObjective(Record):
    """What is learnt from a batch.

    Attributes:
        batch: vehicles a step, over all processes and accumulated parts together.
        condition_drop: probability for a sample to lose its condition.
        time_mean, time_std: of the normal numbers whose logistic function gives the times.
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
