"""Gradient clipping whose bound follows the norms seen so far."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor


class AdaptiveGradClipper:
    """Clip gradients to a percentile of the latest norms, and never above a largest norm.

    As the published TRELLIS trainer does: the norms stored are those before clipping; until
    `window` of them are there, the bound is `max_norm`. Norms that are not finite are not stored.

    Args:
        max_norm: largest bound.
        percentile: of the stored norms, 0 to 100.
        window: number of latest norms that count.

    Attributes:
        bound: the norm to which the next gradients are clipped.

    Raises:
        ValueError: an argument out of its range.
    """

    def __init__(self, max_norm: float = 1.0, percentile: float = 95.0, window: int = 1000) -> None:
        if not max_norm > 0 or not 0 <= percentile <= 100 or window < 1:
            raise ValueError(f"gradient clipper: {max_norm=}, {percentile=}, {window=}")
        self.max_norm = max_norm
        self.percentile = percentile
        self.window = window
        self.bound = max_norm
        self._norms: deque[float] = deque(maxlen=window)  # oldest first

    def clip(self, parameters: Iterable[Tensor]) -> float:
        """Scale the gradients, in place, to the bound at most, then move the bound.

        Returns:
            L2 norm of all gradients before. Where it is not finite the gradients are useless and
            the optimiser's step must be left out.
        """
        norm = float(torch.nn.utils.clip_grad_norm_(parameters, self.bound))
        if np.isfinite(norm):
            self._norms.append(norm)
            self._follow()
        return norm

    def _follow(self) -> None:
        if len(self._norms) == self.window:
            self.bound = min(self.max_norm, float(np.percentile(self._norms, self.percentile)))

    def state_dict(self) -> dict[str, Any]:
        """The stored norms, oldest first, for JSON."""
        return {"norms": list(self._norms)}

    def load_state_dict(self, state: dict[str, Sequence[float]]) -> None:
        """Continue with stored norms; of more than `window` the latest count."""
        self._norms = deque((float(norm) for norm in state["norms"]), maxlen=self.window)
        self.bound = self.max_norm
        self._follow()
