"""The low-pass filter of a pass: what it is, and Gaussians made for one drawn through another.

3DGS widens every projected Gaussian by 0.3 px^2 and leaves its opacity, so that small ones gain
weight. Mip-Splatting (Yu et al. 2024) lowers the opacity by as much as the Gaussian grew; TRELLIS
trains its decoder through that filter with 0.1 px^2. An asset looks right only through the filter
that it was made for, and a scene is drawn in one pass.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path

import torch
from torch import Tensor

from recast.core.errors import InputError
from recast.splats.gaussians import LOG_SCALES, Gaussians, quat_to_matrix

_LEAST_SHARE = 1e-4
"""Smallest share of itself to which a variance is lowered."""
_LEAST_OPAQUE, _MOST_OPAQUE = 1e-12, 1 - 1e-4
_LARGEST_EXPONENT = 80.0  # of e in float32
_LARGEST_FACTOR = 1e38  # of an opacity in float32: infinity times zero is not a number
_INSIDE = 1e-3  # the ends of a range do not belong to it


@dataclass(frozen=True)
class LowPass:
    """A low-pass filter on the image plane.

    Attributes:
        variance: variance added to every projected covariance, px^2; `eps2d` of `rasterize`.
        antialiased: whether opacity is lowered so that the filter keeps a Gaussian's integral.

    Raises:
        ValueError: a variance that is negative or not finite.
    """

    variance: float = 0.3
    antialiased: bool = False

    def __post_init__(self) -> None:
        if not (isfinite(self.variance) and self.variance >= 0):
            raise ValueError(f"LowPass.variance: {self.variance}, expected 0 or more")

    def text(self) -> str:
        """How files declare it, such as "0.1 antialiased"; see `parse_low_pass`."""
        return f"{self.variance:g}{' antialiased' if self.antialiased else ''}"


def parse_low_pass(where: str | Path, text: str) -> LowPass:
    """The filter that a file declares.

    Args:
        where: the file, for messages.

    Raises:
        InputError: it cannot be understood.
    """
    match text.split():
        case [variance, *kind] if kind in ([], ["antialiased"]):
            with suppress(ValueError):
                return LowPass(float(variance), antialiased=bool(kind))
    raise InputError(
        where,
        "low-pass filter",
        f"{text!r} cannot be understood",
        "write a variance in px^2, such as '0.1 antialiased'",
    )


CLASSIC = LowPass()
"""3D Gaussian splatting (Kerbl et al. 2023) and its viewers; the default of `rasterize`, through
which scenes are trained and drawn."""
MIP = LowPass(0.1, antialiased=True)
"""Mip-Splatting; TRELLIS and what is trained like it."""


def refiltered(
    gaussians: Gaussians, made_for: LowPass, drawn_by: LowPass, camera_from_world: Tensor, K: Tensor
) -> Gaussians:
    """Gaussians that look through one filter as these do through the filter they were made for.

    For one view. Their variances are lowered by what the pass adds too much, in px^2 at their depth
    and as far as they go; their opacities are set so that each keeps its integral over the image.
    Gaussians larger than the filters come out the same; of those much smaller than a pixel the
    weight is the same, spread a little wider.

    Args:
        gaussians: N Gaussians in the world frame.
        made_for: filter that they were made for.
        drawn_by: filter of the pass.
        camera_from_world: (4, 4) rigid, OpenCV axes.
        K: (3, 3) pinhole intrinsics, pixels.
    """
    if made_for == drawn_by or len(gaussians) == 0:
        return gaussians
    camera_from_world, K = camera_from_world.to(gaussians.means), K.to(gaussians.means)
    rotation, translation = camera_from_world[:3, :3], camera_from_world[:3, 3]
    x, y, z = (gaussians.means @ rotation.T + translation).unbind(-1)
    z = z.clamp(min=1e-3)  # what is behind the camera is not drawn
    fx, fy, zero = K[0, 0] / z, K[1, 1] / z, torch.zeros_like(z)
    rows = [torch.stack([fx, zero, -fx * x / z], -1), torch.stack([zero, fy, -fy * y / z], -1)]
    pixels_from_axes = torch.stack(rows, dim=1) @ rotation @ quat_to_matrix(gaussians.quats)

    surplus = (drawn_by.variance - made_for.variance) / (fx * fy)  # px^2 as a variance in space
    share = 1 - surplus[:, None] * (-2 * gaussians.log_scales).clamp(max=_LARGEST_EXPONENT).exp()
    log_scales = gaussians.log_scales + 0.5 * share.clamp(min=_LEAST_SHARE).log()
    log_scales = log_scales.clamp(LOG_SCALES[0] + _INSIDE, LOG_SCALES[1] - _INSIDE)
    before = _weight(pixels_from_axes, gaussians.log_scales, made_for)
    after = _weight(pixels_from_axes, log_scales, drawn_by)
    factor = (before / after.clamp(min=1e-60)).clamp(max=_LARGEST_FACTOR).to(z)
    opacities = gaussians.logit_opacities.sigmoid() * factor
    logits = opacities.clamp(_LEAST_OPAQUE, _MOST_OPAQUE).logit()
    return replace(gaussians, log_scales=log_scales, logit_opacities=logits)


def _weight(pixels_from_axes: Tensor, log_scales: Tensor, low_pass: LowPass) -> Tensor:
    """Integral over the image of Gaussians of opacity one, over 2 pi, px^2, float64.

    Args:
        pixels_from_axes: (N, 2, 3) matrices from metres along a Gaussian's axes to pixels.
        log_scales: (N, 3).
    """
    axes = pixels_from_axes.double() * log_scales.double().exp()[:, None]
    first, second = axes.unbind(1)
    determinant = torch.linalg.cross(first, second).square().sum(-1)
    if not low_pass.antialiased:  # of covariance + variance I
        trace = axes.square().sum(dim=(1, 2))
        determinant = determinant + low_pass.variance * (trace + low_pass.variance)
    return determinant.sqrt()
