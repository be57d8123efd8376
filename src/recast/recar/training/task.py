"""The seam between what is trained and the loop that trains it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import torch
from torch import Tensor, nn


@dataclass(frozen=True)
class StepRandom:
    """All randomness of one step: it depends on seed, step and part alone, so a run can resume.

    Attributes:
        numpy: for choices of data.
        torch: for noise, on the CPU.
    """

    numpy: np.random.Generator
    torch: torch.Generator

    @staticmethod
    def of(seed: int, step: int, part: int = 0) -> StepRandom:
        """The randomness of a step, or of one of its accumulated parts."""
        rng = np.random.default_rng([seed, step, part])
        return StepRandom(rng, torch.Generator().manual_seed(int(rng.integers(2**31))))


@dataclass(frozen=True)
class StepLoss:
    """Loss of one batch.

    Attributes:
        loss: scalar with its graph.
        logs: values to show and write, by name.
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
