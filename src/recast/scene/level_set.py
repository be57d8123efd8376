"""All training views at the resolutions that a run passes through."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from recast.scene.background_points import near_samples
from recast.scene.config import SceneConfig
from recast.scene.initialise import Initialisation
from recast.scene.levels import Mask, StoredLevel, make_level
from recast.scene.lidar import DepthSamples
from recast.scene.views import View


def make_levels(
    config: SceneConfig, views: Sequence[View], start: Initialisation
) -> dict[int, list[StoredLevel]]:
    """By factor of `schedule.coarse_factor`, the training views in order."""
    factors = set(config.coarse_factors) if config.coarse_fraction > 0 else set()
    levels: dict[int, list[StoredLevel]] = {factor: [] for factor in sorted(factors | {1})}
    for view, pixels, samples in zip(views, start.sky_pixels, start.depths, strict=True):
        sky = np.zeros((view.camera.height, view.camera.width), bool)
        sky.reshape(-1)[pixels] = True
        ground = _ground(config, view, sky, samples)
        for factor, own in levels.items():
            own.append(make_level(view, sky, ground, samples, factor))
    return levels


def _ground(config: SceneConfig, view: View, sky: Mask, samples: DepthSamples) -> Mask | None:
    """Pixels that are surely no sky: all others, as far as they count.

    The guessed sky errs on the small side; then only pixels near a LiDAR return are sure.
    """
    if config.sky_loss != "entropy" and config.solid_weight == 0:
        return None
    ground = ~sky if view.mask is None else view.mask & ~sky
    return ground & near_samples(view, samples) if config.sky_mask == "heuristic" else ground
