"""What hangs on a run's step: learning rates, when Gaussians come and go, random choices."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from recast.reconstruction.config import SceneConfig
from recast.reconstruction.settings import OPTIM

FLIPS, DEFORMATION = 1, 2
"""Streams of what a step sees mirrored, and of the first weights of the deformation network;
density control has the one without a number."""


def gaussian_rates(config: SceneConfig, u: float) -> dict[str, float]:
    """Learning rate of each field of the Gaussians; `sh` is that of the constant band."""
    return {
        "means": config.means_lr * OPTIM.means_decay**u,
        "quats": config.quats_lr,
        "log_scales": config.scales_lr * OPTIM.scales_decay**u,
        "logit_opacities": config.opacities_lr * OPTIM.opacities_decay**u,
        "sh": config.colours_lr * OPTIM.colours_decay**u,
    }


def pose_factor(u: float) -> float:
    """Factor on the learning rates of poses: none at first, then falling to a twentieth."""
    return 0.0 if u < OPTIM.poses_from else 1 - OPTIM.poses_fall * u


def coarse_factor(config: SceneConfig, u: float) -> int:
    """By how much width and height are divided: each factor has an equal part of the coarse run."""
    factors = config.coarse_factors
    if u >= config.coarse_fraction or not factors:
        return 1
    return factors[min(int(u / config.coarse_fraction * len(factors)), len(factors) - 1)]


@dataclass(frozen=True)
class DensitySchedule:
    """The steps of density control; all its spans are shares of the run, so they hold for any.

    recast's own recipe grows by a share of all Gaussians at a time and never resets opacities;
    that of 3DGS, which both published trainers follow, takes every row above the threshold and
    resets. Both are numbers of the configuration.

    Attributes:
        views: training images, by whose number a pause after a reset is measured.
    """

    config: SceneConfig
    views: int

    def goes_on(self, iteration: int) -> bool:
        """Whether the population may still change after this step (from 0)."""
        return iteration < self.config.densify_until * self.config.iterations

    def counts(self, iteration: int) -> bool:
        """Whether the screen-space gradients of this step (from 0) count.

        They count for the next change; where a pause leaves that out, they are of no use to a later
        one, as a reset made them what they are.
        """
        every = self.config.densify_every
        following = (iteration // every + 1) * every
        return self.goes_on(iteration) and not self._pauses(following)

    def counts_sizes(self, iteration: int) -> bool:
        """Whether absolute ones are needed for that."""
        measures = {self.config.densify_by, self.config.actor_densify_by}
        return self.counts(iteration) and measures != {"signed"}

    def changes(self, iteration: int) -> bool:
        """Whether the population changes when `iteration` steps are done."""
        config = self.config
        return (
            iteration % config.densify_every == 0
            and iteration >= config.densify_from * config.iterations
            and self.goes_on(iteration)
            and not self._pauses(iteration)
        )

    def resets(self, iteration: int) -> bool:
        """Whether opacities are reset when `iteration` steps are done; never at the very end."""
        period, steps = self._period(), self.config.iterations
        last = min(math.floor(self.config.opacity_reset_until * steps), steps - 1)
        return period > 0 and iteration % period == 0 and period <= iteration <= last

    def prunes_oversize(self, iteration: int) -> bool:
        """Whether there has been a reset before: until then large Gaussians may still shrink."""
        return 0 < self._period() < iteration

    def _pauses(self, iteration: int) -> bool:
        """Whether not every image was seen since the last reset (OmniRe's and gsplat's pause)."""
        if self.config.densify_pause == 0 or self._period() == 0:
            return False
        since = iteration % self._period()
        most = self.config.densify_pause * self._period()
        pause = min(max(self.views, self.config.densify_every), most)
        return 0 < since <= pause and self.resets(iteration - since)

    def _period(self) -> int:
        share = self.config.opacity_reset_every
        return max(1, round(share * self.config.iterations)) if share > 0 else 0


def generator(seed: int, iteration: int, *stream: int) -> torch.Generator:
    """Random numbers of one step, others for every `stream`."""
    words = np.random.SeedSequence([seed, iteration, *stream]).generate_state(1)
    return torch.Generator().manual_seed(int(words[0]))


def picked_view(seed: int, iteration: int, count: int) -> int:
    """The view of a step: each epoch visits every one of `count` once, in an order of its own."""
    epoch, position = divmod(iteration, count)
    return int(np.random.default_rng([seed, epoch]).permutation(count)[position])
