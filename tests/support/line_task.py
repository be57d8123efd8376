"""The smallest training: a line that is fitted, and may break."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import nn

from recast.training.loop import StepLoss, StepRandom
from recast.training.state import TrainerSettings

SETTINGS = TrainerSettings(
    steps=23,
    lr=1e-2,
    schedule="cosine",
    warmup=3,
    weight_decay=0.01,
    ema_decay=0.9,
    accumulate=2,
    seed=4,
    checkpoint_every=5,
    log_every=4,
)


class Line:
    """Fit a line of random slope data; may break or be stopped at a step."""

    def __init__(self, stop_at: int | None = None, bad_from: int | None = None) -> None:
        self.network = nn.Sequential(nn.Linear(3, 8), nn.Tanh(), nn.Linear(8, 1))
        with torch.no_grad():
            for index, parameter in enumerate(self.network.parameters()):
                parameter.copy_(torch.linspace(-1, 1, parameter.numel()).view_as(parameter))
                parameter.mul_(0.3 + 0.1 * index)
        self.stop_at, self.bad_from = stop_at, bad_from
        self.parts: list[tuple[int, int]] = []

    @property
    def modules(self) -> Mapping[str, nn.Module]:
        return {"line": self.network}

    def loss(self, step: int, random: StepRandom) -> StepLoss:
        if step == self.stop_at:
            raise KeyboardInterrupt
        self.parts.append((step, random.part))
        x = torch.randn(16, 3, generator=random.torch)
        offset = float(random.numpy.normal())
        error = (self.network(x) - x.sum(1, keepdim=True) - 0.01 * offset).square().mean()
        if self.bad_from is not None and step >= self.bad_from:
            error = error * math.nan
        return StepLoss(error, {"offset": offset, "odd": offset if step % 2 else math.nan})
