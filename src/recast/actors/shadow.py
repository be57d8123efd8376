"""The contact shadow: flat black Gaussians on the ground under an actor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from recast.splats import Gaussians
from recast.splats.sh import C0

Array = NDArray[np.float64]

_SPACING = 0.14  # metres between Gaussians
_DARKNESS = 0.45  # peak opacity of one; neighbours overlap to about 0.9
_FADE = 0.32  # metres over which the shadow fades out around the footprint
_LIFT = 0.06  # metres: splats of the road are thick and sort by centre, lower ones hide the shadow
_THICKNESS = 0.003


def contact_shadow(low: Array, high: Array, floor: float) -> Gaussians:
    """A soft-edged sheet under the footprint, actor-local, black from every side.

    Args:
        low, high: (3,) bounds of the vehicle in the actor frame, metres.
        floor: height of the ground plane in the actor frame.
    """
    half = (high[:2] - low[:2]) / 2
    centre = (high[:2] + low[:2]) / 2
    axes = []
    for reach in half + _FADE:
        count = max(2, int(np.ceil(2 * reach / _SPACING)) + 1)
        axes.append(np.linspace(-reach, reach, count))
    x, y = (grid.ravel() for grid in np.meshgrid(*axes, indexing="ij"))
    # distance to a rounded rectangle somewhat inside the footprint, negative within
    inset = 0.12
    beyond = np.stack([np.abs(x) - half[0] + 0.3 + inset, np.abs(y) - half[1] + 0.3 + inset], -1)
    distance = (
        np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0) - 0.3
    )
    t = np.clip(1 - (distance + inset) / (_FADE + inset), 0.0, 1.0)
    opacity = _DARKNESS * t * t * (3 - 2 * t)
    kept = opacity > 0.01
    count = int(kept.sum())
    deviations = np.log([0.85 * _SPACING, 0.85 * _SPACING, _THICKNESS])
    means = np.stack(
        [centre[0] + x[kept], centre[1] + y[kept], np.full(count, floor + _LIFT)], axis=-1
    )
    probability = opacity[kept]

    def tensor(values: Array) -> torch.Tensor:
        return torch.as_tensor(values, dtype=torch.float32)

    return Gaussians(
        means=tensor(means),
        quats=tensor(np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))),
        log_scales=tensor(np.tile(deviations, (count, 1))),
        logit_opacities=tensor(np.log(probability / (1 - probability))),
        sh=torch.full((count, 1, 3), -0.5 / C0, dtype=torch.float32),
    )


def darkened(shadow: Gaussians, factor: float) -> Gaussians:
    """A shadow with its opacities times a factor."""
    opacities = (shadow.logit_opacities.sigmoid() * factor).clamp(1e-6, 1 - 1e-4)
    return replace(shadow, logit_opacities=opacities.logit())
