"""The sky as a dome of Gaussians: viewers of splats know no colour at infinity."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray

from recast.scene.sky import SkyMap
from recast.viewer.bake import Splats

Array = NDArray[np.float64]

RADIUS = 700.0
"""Metres; viser draws nothing beyond 1000 m."""
COUNT = 4000
_OVERLAP = 0.7  # standard deviation over the spacing of the centres


def sky_dome(sky: SkyMap, middle: Array, radius: float = RADIUS, count: int = COUNT) -> Splats:
    """Opaque discs on a sphere, in the colours of a sky map.

    Args:
        middle: (3,) centre of the sphere, metres.
        radius: metres.
        count: number of discs, evenly spread.
    """
    index = np.arange(count)
    z = 1 - (2 * index + 1) / count
    azimuth = index * math.pi * (3 - math.sqrt(5))
    flat = np.sqrt(1 - z * z)
    directions = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), z], axis=-1)
    spacing = radius * math.sqrt(4 * math.pi / count)
    normals = directions[:, :, None] * directions[:, None, :]
    covariances = (_OVERLAP * spacing) ** 2 * (np.eye(3) - normals) + normals
    with torch.no_grad():
        colours = sky(torch.from_numpy(directions).float()).numpy()
    return Splats(
        centres=(middle + radius * directions).astype(np.float32),
        covariances=covariances.astype(np.float32),
        colours=colours.astype(np.float32),
        opacities=np.ones((count, 1), np.float32),
    )
