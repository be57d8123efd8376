"""How a task is trained."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from recast.records import Record

Share = Annotated[float, Field(ge=0, lt=1)]


class TrainerSettings(Record):
    """Optimiser, schedule and bookkeeping of one training.

    Attributes:
        steps: of the optimiser.
        lr: peak learning rate of AdamW.
        schedule: constant after the warm-up, or a cosine down to 1 % of the peak.
        warmup: steps over which the rate rises linearly.
        betas, weight_decay: of AdamW.
        ema_decay: of the moving average of the weights; None keeps none.
        clip: norm to which gradients are clipped; "adaptive" as the published trainer does.
        accumulate: batches a step.
        seed: of everything random.
        checkpoint_every: steps between checkpoints.
        log_every: steps between lines of the log.
    """

    steps: int = Field(ge=1)
    lr: FiniteFloat = Field(gt=0)
    schedule: Literal["constant", "cosine"] = "constant"
    warmup: int = Field(default=0, ge=0)
    betas: tuple[Share, Share] = (0.9, 0.999)
    weight_decay: FiniteFloat = Field(default=0.0, ge=0)
    ema_decay: Share | None = None
    clip: Annotated[FiniteFloat, Field(gt=0)] | Literal["adaptive"] = "adaptive"
    accumulate: int = Field(default=1, ge=1)
    seed: int = Field(default=0, ge=0)
    checkpoint_every: int = Field(default=500, ge=1)
    log_every: int = Field(default=50, ge=1)

    def same_course(self, other: TrainerSettings) -> bool:
        """Whether both take the same steps, as far as both go.

        How often is written does not matter, nor does where a constant schedule ends.
        """
        free = {"checkpoint_every", "log_every"}
        if self.schedule == "constant":
            free.add("steps")
        return self.model_dump(exclude=free) == other.model_dump(exclude=free)

    def rate(self, step: int) -> float:
        """Learning rate of step number `step`, from 0."""
        warm = min(1.0, (step + 1) / self.warmup) if self.warmup else 1.0
        if self.schedule == "constant":
            return self.lr * warm
        progress = min(1.0, step / self.steps)
        return self.lr * warm * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress)))
