"""Gaussians as most interchange formats hold them: deviations and opacities instead of logarithms.

float32 to float32, so the log scale of what comes back is off by two roundings of its size and one
of the deviation's; an opacity by a few units of 2^-24. Of an opacity nearer to 1 than that, the
logit is not kept; the nearest number below 1 stands for it.
"""

from __future__ import annotations

import torch
from torch import Tensor

from recast.splats.gaussians import LOG_SCALES, Gaussians

_LEAST_OPACITY, _MOST_OPACITY = 1e-38, 1 - 2**-24
_INSIDE = 1e-4  # the ends of LOG_SCALES do not belong to it


def to_linear(gaussians: Gaussians) -> tuple[Tensor, Tensor, Tensor]:
    """Unit quaternions (N, 4) wxyz, standard deviations (N, 3) in metres and opacities (N,)."""
    quats = gaussians.quats / gaussians.quats.norm(dim=1, keepdim=True)
    return quats, gaussians.log_scales.exp(), gaussians.logit_opacities.sigmoid()


def from_linear(
    means: Tensor, quats: Tensor, deviations: Tensor, opacities: Tensor, sh: Tensor
) -> Gaussians:
    """The Gaussians of `to_linear`; deviations and opacities of 0, and opacities of 1, are allowed.

    Others out of range become fields that are not finite, which `Gaussians.fault` names.
    """
    log_scales = torch.where(deviations == 0, LOG_SCALES[0], deviations.log())
    least, most = LOG_SCALES[0] + _INSIDE, LOG_SCALES[1] - _INSIDE
    inside = (opacities >= 0) & (opacities <= 1)
    clamped = opacities.clamp(_LEAST_OPACITY, _MOST_OPACITY).logit()
    return Gaussians(
        means=means,
        quats=quats,
        # What rounding or a flat Gaussian puts on an end of the range, not what lies far beyond it.
        log_scales=torch.where(
            (log_scales >= LOG_SCALES[0] - 1) & (log_scales <= LOG_SCALES[1] + _INSIDE),
            log_scales.clamp(least, most),
            log_scales,
        ),
        logit_opacities=torch.where(inside, clamped, torch.nan),
        sh=sh,
    )
