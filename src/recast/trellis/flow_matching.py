"""The flow-matching objective."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

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
