"""From points of a mesh to flat Gaussians: few where nothing changes, many where colours do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import spence

from recast.actors.mesh.outside import Outside
from recast.actors.mesh.sample import Samples
from recast.actors.template.cloud import tangents
from recast.actors.template.lighting import SH_C0, Daylight, fit_harmonics, to_display
from recast.actors.template.merge import (
    COVERAGE,
    flat_gaussians,
    group_means,
    group_patches,
    shell_groups,
)
from recast.splats import Gaussians
from recast.splats.gaussians import concatenate

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

MOST_GAUSSIANS = 120_000
"""Of a surface, if merging can bring it down to that: a rollout pays for each."""
_OPACITY = 0.99
_OPACITIES = np.linspace(0.001, _OPACITY, 1000)
_TAKEN = spence(1 - _OPACITIES)  # the dilogarithm Li2 of them
_CELLS = (0.04, 0.02)  # metres: points that look alike are merged in voxels of these edges
_TOLERANCES = (0.03, 0.06, 0.12, 0.25, 0.5)  # display values
_SHELL_CELL = 0.10  # metres
_SHELL_DEPTHS = (0.04, 0.10)  # metres behind the surface: of its own colour, and the dark inside
_MARGIN, _NEAR = 0.13, 0.065  # metres: so far beside a wide Gaussian, the surface is so near
_DARK = 0.06  # display value of a cabin without light


def surfels(vehicle: Outside, light: Daylight) -> Gaussians:
    """Flat Gaussians of samples in metres, z up, in daylight.

    Samples of a voxel that look alike become one Gaussian, as wide as they are together
    (`template.merge.flat_gaussians`); light is baked as into a template (`template.lighting`).
    Squares of edge e side by side, each a Gaussian of deviation c e / sqrt(12), overlap
    n = 2 pi c^2 / 12 times. A Gaussian of opacity o takes n Li2(o) from the logarithm of what a
    square lets through (the integral of -log(1 - o exp(-r^2 / 2)) is 2 pi Li2(o)), so that for
    glass o solves n Li2(o) = -log(1 - alpha).
    """
    samples = vehicle.samples
    group = _groups(samples)
    floor = float(samples.points[:, 2].min())
    surface = _lit(samples, group, floor, light)
    (alpha,) = group_means(group, samples.alpha)
    alone, merged = COVERAGE
    overlap = np.pi / 6 * np.where(np.bincount(group) > 1, merged, alone) ** 2
    taken = -np.log(1 - np.minimum(alpha, _OPACITY)) / overlap
    opacity = np.where(alpha < 1, np.interp(taken, _TAKEN, _OPACITIES), _OPACITY)
    logits = torch.from_numpy(np.log(opacity / (1 - opacity))).float()
    parts = [replace(surface, logit_opacities=logits)]
    if vehicle.closed.any():
        parts += _shells(samples.select(vehicle.closed), floor, light, bool((alpha < 1).any()))
    return concatenate(parts)


def _groups(samples: Samples) -> Ints:
    """(N,) the Gaussian of each sample; what is less alike is merged if there are too many."""
    look = np.c_[to_display(samples.albedo), 0.1 * samples.gloss, samples.alpha]
    for tolerance in _TOLERANCES:
        group = group_patches(samples.points, samples.normals, look, _CELLS, tolerance)
        if int(group.max()) < MOST_GAUSSIANS:
            break
    return group


def _lit(samples: Samples, group: Ints, floor: float, light: Daylight) -> Gaussians:
    """One opaque Gaussian a group, in daylight."""
    points, normals, albedo, gloss = group_means(
        group, samples.points, samples.normals, samples.albedo, samples.gloss
    )
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    sh = fit_harmonics(albedo, gloss, normals, points[:, 2] - floor, light)
    return flat_gaussians(group, samples.points, samples.normals, samples.spacing, sh, _OPACITY)


def _shells(closed: Samples, floor: float, light: Daylight, windows: bool) -> list[Gaussians]:
    """Coarse sheets behind the surface.

    The first has its colour and closes its gaps. The second is dark: through windows, one does not
    see the paint of the far side from within. Cells near an edge or of several colours have none,
    or they would show in openings and around wheels.
    """
    group = shell_groups(closed.points, closed.normals, _SHELL_CELL)
    look = to_display(closed.albedo)
    centres, normals, mean, square = group_means(
        group, closed.points, closed.normals, look, look**2
    )
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    inner = (square - mean**2).max(axis=1) < _TOLERANCES[0] ** 2
    tree = cKDTree(closed.points)
    behind = centres - _SHELL_DEPTHS[0] * normals
    for way in tangents(normals):
        for sign in (-1, 1):
            beside = behind + sign * _MARGIN * way
            distance, nearest = tree.query(beside)
            above = np.sum((beside - closed.points[nearest]) * closed.normals[nearest], axis=1)
            inner &= (distance < _NEAR) & (above < 0)
    if not inner.any():
        return []
    kept = closed.select(inner[group])
    group = np.unique(group[inner[group]], return_inverse=True)[1]
    (inwards,) = group_means(group, -kept.normals)
    sheet = _lit(kept, group, floor, light)
    step = torch.from_numpy(inwards).float()
    near, far = (replace(sheet, means=sheet.means + depth * step) for depth in _SHELL_DEPTHS)
    dark = torch.zeros_like(far.sh)
    dark[:, 0] = (_DARK - 0.5) / SH_C0
    return [near, replace(far, sh=dark)] if windows else [near]
