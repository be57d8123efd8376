"""What smooths a training: a clipper of gradients and a moving average of weights."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from recast.core.torch_file import require_state


class AdaptiveGradClipper:
    """Clip gradients to a percentile of the latest norms, and never above a largest norm.

    As the published TRELLIS trainer does: the norms stored are those before clipping; until
    `window` of them are there, the bound is `max_norm`. Norms that are not finite are not stored.

    Args:
        max_norm: largest bound.
        percentile: percentile of the stored norms, 0 to 100.
        window: number of latest norms that count.

    Attributes:
        bound: the norm to which the next gradients are clipped.

    Raises:
        ValueError: an argument out of its range.
    """

    def __init__(self, max_norm: float = 1.0, percentile: float = 95.0, window: int = 1000) -> None:
        if not max_norm > 0 or not 0 <= percentile <= 100 or window < 1:
            raise ValueError(
                f"gradient clipper: out of range: {max_norm=}, {percentile=}, {window=}"
            )
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


class ExponentialMovingAverage:
    """Average of the weights over training steps, w <- decay w + (1 - decay) model.

    It starts from the weights that the model has now, so make it after they are loaded: an average
    begun at the random initialisation still holds 0.9999^10000 = 37 % of it after ten thousand
    steps, as in the published trainer's fine-tuning. Parameters are averaged in float32 or more,
    whatever their type in the model (torch's `AveragedModel` keeps their type). Buffers, such as
    stored position tables, are not averaged: they are the model's latest.

    Args:
        model: its state dictionary is the one followed.
        decay: weight of the past, per step.

    Raises:
        ValueError: no decay in [0, 1).
    """

    def __init__(self, model: nn.Module, decay: float = 0.9999) -> None:
        if not 0 <= decay < 1:
            raise ValueError(f"moving average: decay {decay}, expected at least 0 and below 1")
        self.decay = decay
        self._averaged = {name for name, _ in model.named_parameters(remove_duplicate=False)}
        self._state = {
            name: value.detach().to(self._dtype(name, value), copy=True)
            for name, value in model.state_dict().items()
        }

    def _dtype(self, name: str, value: Tensor) -> torch.dtype:
        if name not in self._averaged:
            return value.dtype
        return torch.promote_types(value.dtype, torch.float32)

    @torch.no_grad()
    def update(self, model: nn.Module) -> None:
        """Take one step towards the weights of the model.

        Raises:
            ValueError: names or shapes of the model differ from those at the start.
        """
        for name, average, value in self._pairs(model):
            if name in self._averaged:
                average.lerp_(value.to(average), 1 - self.decay)
            else:
                average.copy_(value)

    @torch.no_grad()
    def copy_to(self, model: nn.Module) -> None:
        """Overwrite the weights of the model, in its own types, with the averages.

        Raises:
            ValueError: as `update`.
        """
        for _, average, value in self._pairs(model):
            value.copy_(average)

    def _pairs(self, model: nn.Module) -> list[tuple[str, Tensor, Tensor]]:
        state = model.state_dict()
        if {n: v.shape for n, v in state.items()} != {n: v.shape for n, v in self._state.items()}:
            raise ValueError("moving average: names or shapes of the model have changed")
        return [(name, self._state[name], value) for name, value in state.items()]

    def state_dict(self) -> dict[str, Tensor]:
        """Averages and buffers by name, in the order of the model; the next update changes them."""
        return dict(self._state)

    @torch.no_grad()
    def load_state_dict(
        self, state: Mapping[str, Tensor], where: str | Path = "moving average"
    ) -> None:
        """Continue from saved averages.

        Raises:
            InputError: a tensor is missing, unknown or of another shape, see `require_state`;
                nothing is changed then.
        """
        require_state(where, state, self._state, "load the averages of the same model")
        for name, average in self._state.items():
            average.copy_(state[name])
