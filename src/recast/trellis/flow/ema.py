"""Exponential moving average of a model's weights."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from recast.errors import InputError


class ExponentialMovingAverage:
    """Average of the weights over training steps, w <- decay w + (1 - decay) model.

    It starts from the weights that the model has now, so make it after they are loaded: an average
    begun at the random initialisation still holds 0.9999^10000 = 37 % of it after ten thousand
    steps, as in the published trainer's fine-tuning.

    Parameters are averaged in float32 or more, whatever their type in the model. Buffers, such as
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
            InputError: a tensor is missing, unknown or of another shape; nothing is changed then.
        """
        mend = "load the averages of the same model"
        for name in sorted(self._state.keys() ^ state.keys()):
            raise InputError(where, name, "unknown" if name in state else "missing", mend)
        for name, average in self._state.items():
            if state[name].shape != average.shape:
                found, expected = tuple(state[name].shape), tuple(average.shape)
                raise InputError(where, name, f"has shape {found}, expected {expected}", mend)
        for name, average in self._state.items():
            average.copy_(state[name])
