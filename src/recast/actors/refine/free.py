"""The free parameters of a vehicle's Gaussians, and how far each may go."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from recast.actors.shares import Shares
from recast.splats import Gaussians
from recast.splats.rotations import quat_to_matrix

FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh")
_SMALLEST, _LARGEST = math.log(0.006), math.log(0.25)  # metres, as logarithms
_FINEST = 0.012  # metres: smaller ones are not split


class FreeGaussians:
    """prior + freedom x change, field by field: Adam's steps shrink with the freedom.

    Args:
        prior: actor frame; harmonics of any degree become at least those of degree 1.
        freedom: (N,) in [0, 1].

    Attributes:
        changes: leaf tensors by field.
    """

    def __init__(self, prior: Gaussians, freedom: Tensor) -> None:
        if prior.sh.shape[1] < 4:
            room = (0, 0, 0, 4 - prior.sh.shape[1])
            prior = replace(prior, sh=torch.nn.functional.pad(prior.sh, room))
        self.prior, self.freedom = prior.detach(), freedom
        self.changes = {
            name: torch.zeros_like(getattr(self.prior, name), requires_grad=True) for name in FIELDS
        }

    def __call__(self) -> Gaussians:
        """The Gaussians as they stand; differentiable in the changes."""
        value = {}
        for name, change in self.changes.items():
            prior: Tensor = getattr(self.prior, name)
            freedom = self.freedom.view(-1, *[1] * (prior.ndim - 1))
            value[name] = prior + freedom * change
        value["log_scales"] = value["log_scales"].clamp(_SMALLEST, _LARGEST)
        return Gaussians(**value)

    def strain(self) -> Tensor:
        """Pull towards the prior: squares of shifts over 5 cm, of scales, of degree one."""
        moved = (self.freedom[:, None] * self.changes["means"] / 0.05).square().mean()
        grown = (self.freedom[:, None] * self.changes["log_scales"]).square().mean()
        turned = (self.freedom[:, None, None] * self.changes["sh"][:, 1:]).square().mean()
        return 0.02 * moved + 0.005 * grown + 0.02 * turned


def split(gaussians: Gaussians, shares: Shares, chosen: Tensor) -> tuple[Gaussians, Shares]:
    """The chosen Gaussians (N,) cut in two along their longest axis, half as long each.

    The halves' centres lie half a deviation to either side, which keeps the mean and, with 0.87 of
    the old deviation along that axis, the variance.
    """
    chosen = chosen & (gaussians.log_scales.amax(dim=1) > math.log(_FINEST))
    kept, cut = gaussians.select(~chosen), gaussians.select(chosen)
    longest = cut.log_scales.argmax(dim=1)
    axes = quat_to_matrix(cut.quats)
    axis = axes.gather(2, longest[:, None, None].expand(-1, 3, 1))[:, :, 0]
    step = 0.6 * cut.log_scales.amax(dim=1, keepdim=True).exp() * axis
    shorter = cut.log_scales.clone()
    shorter.scatter_add_(1, longest[:, None], torch.full((len(cut), 1), math.log(0.65)))
    halves = [replace(cut, means=cut.means + way * step, log_scales=shorter) for way in (1, -1)]
    merged = Gaussians(
        **{
            name: torch.cat([getattr(part, name) for part in (kept, *halves)]).contiguous()
            for name in FIELDS
        }
    )
    return merged, Shares(
        *(torch.cat([s[~chosen], s[chosen], s[chosen]]) for s in (shares.seen, shares.mirrored))
    )
