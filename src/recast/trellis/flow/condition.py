"""Image tokens that condition a flow: one or several views of each sample, or dropped."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

MultiImageMode = Literal["stochastic", "multidiffusion"]


@dataclass(frozen=True)
class Condition:
    """Image tokens of the samples of a batch.

    Attributes:
        views: (V, B, L, C) tokens of V views of every sample; B = 1 serves any number of samples.
        mode: of several views, "stochastic" uses one view in each step, in turn from the first,
            the same for all samples; "multidiffusion" the mean of the velocities of all views.

    Raises:
        ValueError: not four axes, no view, or another mode.
    """

    views: Tensor
    mode: MultiImageMode = "stochastic"

    def __post_init__(self) -> None:
        if self.views.ndim != 4 or len(self.views) == 0:
            raise ValueError(f"condition: views {tuple(self.views.shape)}, expected (V, B, L, C)")
        if self.mode not in ("stochastic", "multidiffusion"):
            raise ValueError(f"condition: mode {self.mode!r}, no stochastic or multidiffusion")

    def for_samples(self, samples: int) -> Tensor:
        """The views (V, samples, L, C); tokens that serve all samples are not copied.

        Raises:
            ValueError: the tokens are of another number of samples.
        """
        count = self.views.shape[1]
        if count not in (1, samples):
            raise ValueError(f"condition: tokens of {count} samples for {samples}")
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
        cond: (B, L, C).
        probability: for a sample to lose its tokens (published: 0.1).
        generator: its device may differ from that of `cond`.

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
