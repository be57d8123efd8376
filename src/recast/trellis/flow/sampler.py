"""Euler sampling of a flow with classifier-free guidance in an interval of time."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from recast.errors import InputError
from recast.trellis.flow.condition import Condition
from recast.trellis.flow.path import TIME_SCALE, Velocity, data_from_velocity
from recast.trellis.flow.settings import SamplerSettings, time_steps


@dataclass(frozen=True)
class StepRecord:
    """One step that was taken, from `t` to `t_next`.

    Attributes:
        step: its number, from 0.
        t, t_next: times, 1 is noise.
        guided: whether guidance acted.
        views: indices of the views used.
        before: x at `t`, of the shape of the noise.
        velocity: of the step, guidance included.
        after: x at `t_next`.
        sigma_min: of the settings.
    """

    step: int
    t: float
    t_next: float
    guided: bool
    views: tuple[int, ...]
    before: Tensor
    velocity: Tensor
    after: Tensor
    sigma_min: float

    def predicted_data(self) -> Tensor:
        """The data x_0 that this step alone points at; made only when asked for."""
        return data_from_velocity(self.before, self.velocity, self.t, self.sigma_min)


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
        velocity: the network; see `Velocity`.
        noise: standard normal, (B, ...) dense or (T, C) sparse. Left as it is.
        condition: tokens of the samples.
        settings: number of steps, times and guidance.
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
            on_step(StepRecord(step, t, t_next, guided, used, before, v, x, settings.sigma_min))
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
