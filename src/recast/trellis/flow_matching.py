"""The flow-matching objective, and what steadies training: clipped gradients, averaged weights."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from recast.core.torch_file import require_state
from recast.trellis.sampler import TIME_SCALE, Velocity, noise_scale


@dataclass(frozen=True)
class FlowLoss:
    """Loss of one batch.

    Attributes:
        loss: scalar, with the graph; mean squared error over all elements.
        per_sample: (B,) mean squared error of each sample, without graph; NaN for one without rows.
        t: (B,) times of the samples.
    """

    loss: Tensor
    per_sample: Tensor
    t: Tensor

    @property
    def bins(self) -> Tensor:
        """(10,) mean over the samples of each tenth of time, NaN where there are none; for logs."""
        return time_bins(self.per_sample, self.t)


@dataclass(frozen=True)
class FlowMatching:
    """Flow matching on straight paths (Lipman et al. 2023), as TRELLIS is trained.

    Dense data is (B, ...). Sparse data is (T, C), its rows those of all samples one after another;
    `batch` (T,) int64 then says which sample a row belongs to, so that t is always per sample.

    Attributes:
        sigma_min: noise left at t = 0.
    """

    sigma_min: float = 1e-5

    def interpolate(
        self, x0: Tensor, noise: Tensor, t: Tensor, batch: Tensor | None = None
    ) -> Tensor:
        """x_t = (1 - t) x_0 + (sigma + (1 - sigma) t) eps, of the shape of `x0`.

        Args:
            x0, noise: data and standard normal noise, of one shape.
            t: (B,) times in [0, 1].
            batch: (T,) sample of each row, for sparse data.

        Raises:
            ValueError: noise of another shape, or dense data of another number of samples than t.
        """
        if noise.shape != x0.shape:
            raise ValueError(
                f"flow matching: noise {tuple(noise.shape)}, expected {tuple(x0.shape)}"
            )
        rows = t if batch is None else t[batch]
        if len(rows) != len(x0):
            raise ValueError(f"flow matching: {len(rows)} times, expected {len(x0)}")
        rows = rows.view(-1, *[1] * (x0.ndim - 1))
        return (1 - rows) * x0 + noise_scale(rows, self.sigma_min) * noise

    def target(self, x0: Tensor, noise: Tensor) -> Tensor:
        """Velocity dx/dt = (1 - sigma) eps - x_0, the same at all times."""
        return (1 - self.sigma_min) * noise - x0

    def loss(
        self,
        velocity: Velocity,
        x0: Tensor,
        cond: Tensor,
        t: Tensor,
        noise: Tensor,
        batch: Tensor | None = None,
    ) -> FlowLoss:
        """Mean squared error of the velocity over all elements, whatever the time.

        The mean over all rows of sparse data weighs samples by their number of rows.

        Args:
            velocity: the network; it is given 1000 t.
            cond: (B, L, C) tokens, some of them dropped.
            x0, t, noise, batch: see `interpolate`.

        Raises:
            ValueError: as `interpolate`, no data at all, or a prediction of another shape than x0.
        """
        if x0.numel() == 0:
            raise ValueError("flow matching: the batch is empty")
        predicted = velocity(self.interpolate(x0, noise, t, batch), TIME_SCALE * t, cond)
        if predicted.shape != x0.shape:
            raise ValueError(
                f"flow matching: velocity {tuple(predicted.shape)}, expected {tuple(x0.shape)}"
            )
        squared = (predicted - self.target(x0, noise)).square()
        by_row = squared.detach().flatten(1).mean(1)
        per_sample = by_row if batch is None else _group_means(by_row, batch, len(t))
        return FlowLoss(squared.mean(), per_sample, t)


def sample_timesteps(
    count: int, generator: torch.Generator, mean: float = 1.0, std: float = 1.0
) -> Tensor:
    """Times (count,) float32 in [0, 1]: the logistic function of normal numbers.

    Logit-normal (Esser et al. 2024, eq. 19); the mean of 1 of the published models favours noisy
    times. They are made on the generator's device.
    """
    draws = torch.randn(count, generator=generator, device=generator.device)
    return torch.sigmoid(mean + std * draws)


def time_bins(per_sample: Tensor, t: Tensor, count: int = 10) -> Tensor:
    """Mean (count,) of values (B,) over the samples of each of `count` equal parts of time.

    Times `t` are (B,) in [0, 1]. NaNs are left out; a part without samples is NaN.
    """
    part = (t * count).long().clamp(0, count - 1)
    known = ~torch.isnan(per_sample)
    return _group_means(per_sample[known], part[known], count)


def _group_means(values: Tensor, group: Tensor, count: int) -> Tensor:
    sums = values.new_zeros(count).index_add_(0, group, values)
    return sums / torch.bincount(group, minlength=count)


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
