"""The free parameters of a vehicle's Gaussians, and how far each may go."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from recast.splats import Gaussians, concatenate
from recast.splats.rotations import quat_to_matrix

FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh")
_SMALLEST, _LARGEST = math.log(0.006), math.log(0.25)  # metres, as logarithms
_APART, _SHORTER = 0.6, 0.65
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
        self.prior, self._freedom = prior.detach(), freedom
        self.changes = {
            name: torch.zeros_like(getattr(self.prior, name), requires_grad=True) for name in FIELDS
        }

    def _change(self, name: str) -> Tensor:
        change = self.changes[name]
        return self._freedom.view(-1, *[1] * (change.ndim - 1)) * change

    def __call__(self) -> Gaussians:
        """The Gaussians as they stand; differentiable in the changes."""
        value = {name: getattr(self.prior, name) + self._change(name) for name in FIELDS}
        value["log_scales"] = value["log_scales"].clamp(_SMALLEST, _LARGEST)
        return Gaussians(**value)

    def strain(self) -> Tensor:
        """Pull towards the prior: squares of shifts over 5 cm, of scales, of degree one."""
        moved = (self._change("means") / 0.05).square().mean()
        grown = self._change("log_scales").square().mean()
        turned = self._change("sh")[:, 1:].square().mean()
        return 0.2 * moved + 0.05 * grown + 0.2 * turned


def split_rows(gaussians: Gaussians, chosen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Rows that stay whole, and twice those that are to be cut: chosen (N,) bool and not fine."""
    cut = chosen & (gaussians.log_scales.amax(dim=1) > math.log(_FINEST))
    rows = cut.nonzero()[:, 0]
    return (~cut).nonzero()[:, 0], rows, rows


def split(gaussians: Gaussians, whole: Tensor, first: Tensor, second: Tensor) -> Gaussians:
    """Gaussians cut in two along their longest axis; rows as `split_rows` gives them.

    Halves lie 0.6 deviations to either side and are 0.65 times as long: together they keep the
    centre and 0.88 of the deviation (0.6^2 + 0.65^2 = 0.88^2).
    """
    parts = [gaussians.select(whole)]
    for rows, way in ((first, 1), (second, -1)):
        cut = gaussians.select(rows)
        longest = cut.log_scales.argmax(dim=1)[:, None]
        axes = quat_to_matrix(cut.quats)
        axis = axes.gather(2, longest[:, None].expand(-1, 3, 1))[:, :, 0]
        step = _APART * cut.log_scales.amax(dim=1, keepdim=True).exp() * axis
        shorter = torch.full_like(cut.log_scales[:, :1], math.log(_SHORTER))
        parts.append(
            replace(
                cut,
                means=cut.means + way * step,
                log_scales=cut.log_scales.scatter_add(1, longest, shorter),
            )
        )
    return concatenate(parts)
