"""From points of a mesh to flat Gaussians: few where nothing changes, many where colours do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import spence

from recast.actors.hull import require_volume, seen_from_outside
from recast.actors.mesh.sample import Samples
from recast.actors.template.lighting import Daylight, fit_harmonics, to_display
from recast.actors.template.merge import COVERAGE, flat_gaussians, group_means, group_patches
from recast.splats import Gaussians

Array = NDArray[np.float64]

_OPACITY = 0.99
_OPACITIES = np.linspace(0.001, _OPACITY, 1000)
_TAKEN = spence(1 - _OPACITIES)  # the dilogarithm Li2 of them
_CELLS = (0.04, 0.02)  # metres: points that look alike are merged in voxels of these edges
_TOLERANCE = 0.03  # display values


def facing_out(samples: Samples) -> Samples:
    """What can be seen from outside, with normals towards where it is seen from.

    Files wind their triangles either way, and hold engines and the insides of doors; light must
    fall on the outer side. What is seen through glass is kept. The normals of all glass point to
    one half of space, so that the two faces of a pane become one layer.

    Raises:
        ValueError: what is opaque has no volume, see `hull.require_volume`.
    """
    opaque = samples.alpha >= 1
    require_volume(samples.points[opaque])
    directions, seen = seen_from_outside(samples.points[opaque])
    outer = np.zeros((len(samples), 3))
    outer[opaque] = -(seen.T.astype(np.float64) @ directions)
    outer[~opaque] = np.eye(3)[np.argmax(np.abs(samples.normals[~opaque]), axis=1)]
    inward = np.sum(outer * samples.normals, axis=1) < 0
    kept = ~opaque
    kept[opaque] = seen.any(axis=0)
    flipped = np.where(inward[:, None], -samples.normals, samples.normals)
    return replace(samples, normals=flipped).select(kept)


def surfels(samples: Samples, light: Daylight) -> Gaussians:
    """Flat Gaussians of samples in metres, z up, in daylight.

    Samples of a voxel that look alike become one Gaussian, as wide as they are together
    (`template.merge.flat_gaussians`); light is baked as into a template (`template.lighting`).
    Squares of edge e side by side, each a Gaussian of deviation c e / sqrt(12), overlap
    n = 2 pi c^2 / 12 times. A Gaussian of opacity o takes n Li2(o) from the logarithm of what a
    square lets through (the integral of -log(1 - o exp(-r^2 / 2)) is 2 pi Li2(o)), so that for
    glass o solves n Li2(o) = -log(1 - alpha).
    """
    look = np.c_[to_display(samples.albedo), 0.1 * samples.gloss, samples.alpha]
    group = group_patches(samples.points, samples.normals, look, _CELLS, _TOLERANCE)
    points, normals, albedo, gloss, alpha = group_means(
        group, samples.points, samples.normals, samples.albedo, samples.gloss, samples.alpha
    )
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    heights = points[:, 2] - samples.points[:, 2].min()
    sh = fit_harmonics(albedo, gloss, normals, heights, light)
    flat = flat_gaussians(group, samples.points, samples.normals, samples.spacing, sh, _OPACITY)
    alone, merged = COVERAGE
    overlap = np.pi / 6 * np.where(np.bincount(group) > 1, merged, alone) ** 2
    taken = -np.log(1 - np.minimum(alpha, _OPACITY)) / overlap
    opacity = np.where(alpha < 1, np.interp(taken, _TAKEN, _OPACITIES), _OPACITY)
    logits = np.log(opacity / (1 - opacity))
    return replace(flat, logit_opacities=torch.from_numpy(logits).float())
