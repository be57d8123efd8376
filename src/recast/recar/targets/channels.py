"""Mean and spread of every channel of latents, in one pass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ChannelStatistics:
    """Mean and standard deviation by channel, float64 (C,), over all values of all targets."""

    mean: Array
    std: Array


class ChannelMoments:
    """Adds up values, without losing digits to a large mean (Chan et al. 1979)."""

    def __init__(self) -> None:
        self._count = 0
        self._mean: Array = np.zeros(0)
        self._squares: Array = np.zeros(0)

    def add(self, values: NDArray[np.float32]) -> None:
        """Add values (N, C) with N >= 1."""
        block = values.astype(np.float64)
        count, mean = len(block), block.mean(axis=0)
        squares = np.square(block - mean).sum(axis=0)
        if self._count == 0:
            self._count, self._mean, self._squares = count, mean, squares
            return
        total, delta = self._count + count, mean - self._mean
        self._squares = self._squares + squares + delta**2 * self._count * count / total
        self._mean = self._mean + delta * count / total
        self._count = total

    def statistics(self) -> ChannelStatistics | None:
        """Over all values, dividing by their number; None where there are none."""
        if self._count == 0:
            return None
        return ChannelStatistics(self._mean, np.sqrt(self._squares / self._count))
