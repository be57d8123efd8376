"""Gaussians as a browser can draw them: one colour each, and a covariance that float16 can hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.splats import Gaussians
from recast.splats.rotations import quat_to_matrix
from recast.splats.sh import evaluate

Float32Array = NDArray[np.float32]

LARGEST_SIGMA = 250.0
"""Metres. viser stores covariances as float16, which ends at 65504, the square of 256 m."""


@dataclass(frozen=True)
class Splats:
    """N Gaussians with constant colours.

    Attributes:
        centres: (N, 3) float32 metres.
        covariances: (N, 3, 3) float32, all members within the range of float16.
        colours: (N, 3) float32 in [0, 1].
        opacities: (N, 1) float32 in [0, 1].
    """

    centres: Float32Array
    covariances: Float32Array
    colours: Float32Array
    opacities: Float32Array

    def __len__(self) -> int:
        return len(self.centres)


def baked(gaussians: Gaussians, eyes: Tensor) -> Splats:
    """Gaussians with the colour that they have in the mean direction from which `eyes` see them.

    Standard deviations above `LARGEST_SIGMA` are cut to it.

    Args:
        gaussians: in any frame.
        eyes: (E, 3) places of cameras in the same frame; none: along x.
    """
    with torch.no_grad():
        directions = mean_directions(gaussians.means, eyes)
        colours = (evaluate(gaussians.sh, directions) + 0.5).clamp(0, 1)
        sigmas = gaussians.log_scales.exp().clamp(max=LARGEST_SIGMA)
        axes = quat_to_matrix(gaussians.quats) * sigmas[:, None, :]
        return Splats(
            centres=gaussians.means.float().numpy(),
            covariances=(axes @ axes.transpose(1, 2)).float().numpy(),
            colours=colours.float().numpy(),
            opacities=torch.sigmoid(gaussians.logit_opacities)[:, None].float().numpy(),
        )


def mean_directions(points: Tensor, eyes: Tensor) -> Tensor:
    """Unit directions (N, 3) in which points (N, 3) are seen from eyes (E, 3), on average.

    An eye counts by one over its distance, so that the near ones, which see most, decide. Where
    directions cancel out, that of the nearest eye is taken.
    """
    if len(eyes) == 0:
        return torch.tensor([1.0, 0.0, 0.0]).to(points).expand_as(points)
    total = torch.zeros_like(points)
    nearest = torch.full((len(points), 1), float("inf")).to(points)
    fallback = torch.zeros_like(points)
    fallback[:, 0] = 1
    for eye in eyes.to(points):
        away = points - eye
        distance = away.norm(dim=1, keepdim=True).clamp(min=1e-3)
        total += away / distance**2
        fallback = torch.where(distance < nearest, away / distance, fallback)
        nearest = torch.minimum(nearest, distance)
    length = total.norm(dim=1, keepdim=True)
    found = torch.where(length > 1e-6, total / length.clamp(min=1e-6), fallback)
    return found / found.norm(dim=1, keepdim=True).clamp(min=1e-6)
