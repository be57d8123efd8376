"""The seam between what is trained and the loop that trains it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import torch
from torch import Tensor, nn

_WHOLE = 2**32 - 1  # a part number that no part has


@dataclass(frozen=True)
class StepRandom:
    """All randomness of one step: it depends on seed, step and part alone, so a run can resume.

    Attributes:
        numpy: for choices of data.
        torch: for noise, on the CPU.
        part, parts: which part of the step's batch this is; parts are accumulated one after
            another, or by several processes at once.
        seed, step: what everything is derived from.
    """

    numpy: np.random.Generator
    torch: torch.Generator
    part: int = 0
    parts: int = 1
    seed: int = 0
    step: int = 0

    @staticmethod
    def of(seed: int, step: int, part: int = 0, parts: int = 1) -> StepRandom:
        """The randomness of a step, or of one of its accumulated parts."""
        rng = np.random.default_rng([seed, step, part])
        noise = torch.Generator().manual_seed(int(rng.integers(2**31)))
        return StepRandom(rng, noise, part, parts, seed, step)

    def whole(self) -> np.random.Generator:
        """For choices about the step's whole batch: the same for all its parts."""
        return np.random.default_rng([self.seed, self.step, _WHOLE])


@dataclass(frozen=True)
class StepLoss:
    """Loss of one batch.

    Attributes:
        loss: scalar with its graph.
        logs: values to show and write, by name; those that are not finite are left out of means.
            Several processes must give the same names in each step.
    """

    loss: Tensor
    logs: Mapping[str, float] = field(default_factory=dict)


class TrainingTask(Protocol):
    """What is trained, and on what."""

    @property
    def modules(self) -> Mapping[str, nn.Module]:
        """The networks whose parameters are trained, by name."""
        ...

    def loss(self, step: int, random: StepRandom) -> StepLoss:
        """Loss of the batch of a step; the same step and randomness give the same loss."""
        ...
