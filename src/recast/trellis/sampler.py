"""Euler sampling of a flow on the straight path from data to noise, conditioned on image tokens.

With classifier-free guidance in an interval of time.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, ValidationError, field_validator
from torch import Tensor

from recast.core.errors import InputError
from recast.core.records import Record, validation_error

MultiImageMode = Literal["stochastic", "multidiffusion"]
TIME_SCALE = 1000.0
"""The networks are given 1000 t."""

Velocity = Callable[[Tensor, Tensor, Tensor], Tensor]
"""`velocity(x, 1000 t, cond)`: x of any shape, times (B,) float32, conditions (B, L, C).

The result has the shape of x. A sparse network is closed over its coordinates, so that x is (T, C).
"""
PUBLISHED_SAMPLER: Literal["FlowEulerGuidanceIntervalSampler"] = "FlowEulerGuidanceIntervalSampler"

Time = Annotated[float, Field(ge=0, le=1, strict=True)]


@dataclass(frozen=True)
class Condition:
    """Image tokens of the samples of a batch.

    Raises:
        ValueError: not four axes, no view, or another mode.
    """

    # (V, B, L, C) tokens of V views of every sample; B = 1 serves any number of samples.
    views: Tensor
    # use of several views: "stochastic" uses one view in each step, in turn from the first, the
    # same for all samples; "multidiffusion" the mean of the velocities of all views.
    mode: MultiImageMode = "stochastic"

    def __post_init__(self) -> None:
        if self.views.ndim != 4 or len(self.views) == 0:
            raise ValueError(f"condition: views {tuple(self.views.shape)}, expected (V, B, L, C)")
        if self.mode not in ("stochastic", "multidiffusion"):
            raise ValueError(f"condition: mode {self.mode!r} is not stochastic or multidiffusion")

    def for_samples(self, samples: int) -> Tensor:
        """The views (V, samples, L, C); tokens that serve all samples are not copied. Raises
        ValueError: the tokens are of another number of samples."""
        count = self.views.shape[1]
        if count not in (1, samples):
            raise ValueError(f"condition: tokens of {count} samples, expected {samples}")
        return self.views.expand(-1, samples, -1, -1)

    def used_in(self, step: int) -> tuple[int, ...]:
        """Indices of the views that step number `step`, from 0, uses."""
        count = len(self.views)
        return (step % count,) if self.mode == "stochastic" else tuple(range(count))


def drop_condition(
    cond: Tensor, probability: float, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Replace the tokens of random samples by zeros, so that the network learns both velocities.

    Args:
        cond: (B, L, C) tokens.
        probability: probability that a sample loses its tokens (published: 0.1).
        generator: random generator; its device may differ from that of `cond`.

    Returns:
        The tokens, and which samples lost them (B,) bool.

    Raises:
        ValueError: no probability.
    """
    if not 0 <= probability <= 1:
        raise ValueError(f"drop_condition: probability {probability}, expected 0 to 1")
    draws = torch.rand(len(cond), generator=generator, device=generator.device)
    dropped = (draws < probability).to(cond.device)
    return cond.masked_fill(dropped[:, None, None], 0.0), dropped


def noise_scale(t: Tensor | float, sigma_min: float) -> Tensor | float:
    """Standard deviation sigma + (1 - sigma) t of the noise in x_t.

    x_t = (1 - t) x_0 + (sigma + (1 - sigma) t) eps, the path of optimal transport of Lipman et al.
    2023 ("Flow matching for generative modeling", section 4.1), with time reversed.
    """
    return sigma_min + (1 - sigma_min) * t


class _PublishedArgs(Record):
    sigma_min: Any


class _PublishedParams(Record):
    steps: Any
    cfg_strength: Any
    cfg_interval: Any
    rescale_t: Any


class _Published(Record):
    """A sampler of `pipeline.json`; nothing is filled in, the code has other defaults than it."""

    name: Literal["FlowEulerGuidanceIntervalSampler"]
    args: _PublishedArgs
    params: _PublishedParams


class SamplerSettings(Record):
    """Settings of `sample`; the defaults are those of the published TRELLIS checkpoints.

    Attributes:
        steps: number of steps of Euler's method.
        cfg_strength: s of classifier-free guidance, (1 + s) v(cond) - s v(zeros); 0 is none.
        cfg_interval: first and last time t, both included, at which guidance acts (Kynkäänniemi et
            al. 2024). t is 1 for noise and 0 for data, after rescaling.
        rescale_t: r in t' = r t / (1 + (r - 1) t); above 1 more of the steps go to noisy times.
        sigma_min: noise left at t = 0.
    """

    steps: int = Field(default=25, ge=1, le=1000, strict=True)
    cfg_strength: float = Field(default=5.0, ge=0, le=1000, strict=True)
    cfg_interval: tuple[Time, Time] = (0.5, 1.0)
    rescale_t: float = Field(default=3.0, gt=0, le=1000, strict=True)
    sigma_min: float = Field(default=1e-5, ge=0, lt=1, strict=True)

    @field_validator("cfg_interval")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] > value[1]:
            raise ValueError("begins after its end")
        return value

    def merged(self, **overrides: Any) -> Self:
        """These settings with some replaced; an override of None leaves the value as it is. Raises
        InputError: an unknown name, or a value out of its range."""
        given = {name: value for name, value in overrides.items() if value is not None}
        return self._checked({**self.model_dump(), **given}, "sampler settings")

    @classmethod
    def from_published(cls, record: Mapping[str, Any], where: str | Path) -> Self:
        """Read a sampler of the `pipeline.json` at `where`: {"name", "args": {..}, "params": {..}}.

        Nothing is filled in: the published code has other defaults than its checkpoints.

        Args:
            record: its `params` hold steps, cfg_strength, cfg_interval and rescale_t, its `args`
                sigma_min.

        Raises:
            InputError: another sampler class, a missing or unknown name, a value out of its range.
        """
        try:
            found = _Published.model_validate(record)
        except ValidationError as error:
            mend = "use a pipeline.json in the published layout"
            raise validation_error(where, error, mend) from None
        return cls._checked({**dict(found.args), **dict(found.params)}, where)

    def published(self) -> dict[str, Any]:
        """The record that `from_published` reads."""
        params = self.model_dump(mode="json")
        args = {"sigma_min": params.pop("sigma_min")}
        return {"name": PUBLISHED_SAMPLER, "args": args, "params": params}

    @classmethod
    def _checked(cls, values: Mapping[str, Any], where: str | Path) -> Self:
        try:
            return cls.model_validate(values)
        except ValidationError as error:
            raise validation_error(where, error, "correct the sampler setting") from None

    def guided(self, t: float) -> bool:
        """Whether guidance acts at time t."""
        low, high = self.cfg_interval
        return self.cfg_strength > 0 and low <= t <= high


def time_steps(settings: SamplerSettings) -> NDArray[np.float64]:
    """Times (steps + 1,) from exactly 1 (noise) down to exactly 0 (data), strictly decreasing.

    t = r u / (1 + (r - 1) u) for u evenly spaced (Esser et al. 2024, section 5.3.2).
    """
    r = settings.rescale_t
    even = np.linspace(1.0, 0.0, settings.steps + 1)
    times = r * even / (1 + (r - 1) * even)
    times[0] = 1.0  # rounding may leave it above 1, and so outside the guidance interval
    return times


@dataclass(frozen=True)
class StepRecord:
    """One step that was taken, from `t` to `t_next`."""

    step: int  # its number, from 0
    # t, t_next: times, 1 is noise.
    t: float
    t_next: float
    guided: bool  # whether guidance acted
    views: tuple[int, ...]  # indices of the views used
    # before, after: x at `t` and at `t_next`, of the shape of the noise.
    before: Tensor
    velocity: Tensor  # velocity of the step, guidance included
    after: Tensor


@torch.no_grad()
def sample(
    velocity: Velocity,
    noise: Tensor,
    condition: Condition,
    settings: SamplerSettings,
    *,
    samples: int | None = None,
    on_step: Callable[[StepRecord], None] | None = None,
) -> Tensor:
    """Follow the flow from noise to data by Euler's method, as the published TRELLIS samplers do.

    x(t') = x(t) - (t - t') v. Inside `settings.cfg_interval` v = (1 + s) v(cond) - s v(zeros): a
    strength s of 5 weighs the condition sixfold (Ho and Salimans 2022 in that form). Outside, and
    for s = 0, v = v(cond) and the network runs once per view.

    Args:
        noise: standard normal noise, (B, ...) dense or (T, C) sparse. Left as it is.
        samples: number B of samples; needed for sparse noise, whose rows are not samples.
        on_step: called after each step. Tensors of the record that it keeps stay in memory.

    Returns:
        Data of the shape of `noise`; no graph is kept.

    Raises:
        InputError: a velocity holds NaN or infinity; the message names the step.
        ValueError: tokens of another number of samples, or a velocity of another shape than x.
    """
    samples = len(noise) if samples is None else samples
    views = condition.for_samples(samples)
    if condition.mode == "stochastic" and len(views) > settings.steps:
        warnings.warn(
            f"{len(views)} views but {settings.steps} sampling steps: the last views are not used",
            RuntimeWarning,
            stacklevel=3,  # through no_grad's wrapper
        )
    nothing = torch.zeros_like(views[0, :1]).expand_as(views[0])
    times = time_steps(settings).tolist()
    x = noise
    for step, (t, t_next) in enumerate(pairwise(times)):
        model_t = torch.full((samples,), TIME_SCALE * t, dtype=torch.float32, device=x.device)
        used, guided = condition.used_in(step), settings.guided(t)
        v = velocity(x, model_t, views[used[0]])
        if len(used) > 1:
            for view in used[1:]:
                v = v + velocity(x, model_t, views[view])
            v = v / len(used)
        if guided:
            s = settings.cfg_strength
            v = (1 + s) * v - s * velocity(x, model_t, nothing)
        _check(v, x, step, settings.steps, t)
        before, x = x, x - (t - t_next) * v
        if on_step is not None:
            on_step(StepRecord(step, t, t_next, guided, used, before, v, x))
    return x


def _check(v: Tensor, x: Tensor, step: int, steps: int, t: float) -> None:
    if v.shape != x.shape:
        raise ValueError(f"sample: velocity {tuple(v.shape)} for x {tuple(x.shape)}")
    if not bool(torch.isfinite(v).all()):
        raise InputError(
            "sampler",
            f"step {step + 1} of {steps} (t = {t:.4g})",
            "the velocity is not finite",
            "run the model in float32, and check its weights and the condition",
        )


@dataclass(frozen=True)
class FlowLoss:
    """Loss of one batch."""

    loss: Tensor  # scalar, with the graph; mean squared error over all elements
    # (B,) mean squared error of each sample, without graph; NaN for one without rows.
    per_sample: Tensor
    t: Tensor  # (B,) times of the samples

    @property
    def bins(self) -> Tensor:
        """(10,) mean over the samples of each tenth of time, NaN where there are none; for logs."""
        return time_bins(self.per_sample, self.t)


@dataclass(frozen=True)
class FlowMatching:
    """Flow matching on straight paths (Lipman et al. 2023), as TRELLIS is trained.

    Dense data is (B, ...). Sparse data is (T, C), its rows those of all samples one after another;
    `batch` (T,) int64 then says which sample a row belongs to, so that t is always per sample.
    """

    sigma_min: float = 1e-5  # noise left at t = 0

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
