"""From surface patches to flat Gaussians: few where nothing changes, many where colours do."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from recast.actors.template.surface import voxel_ids
from recast.geometry import se3
from recast.splats.gaussians import Gaussians

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_THICKNESS = 0.002
COVERAGE = (1.75, 2.1)
"""Standard deviation of a Gaussian over that of its patch, and of a group of patches."""


def group_patches(
    points: Array, normals: Array, colours: Array, cells: tuple[float, ...], tolerance: float
) -> Ints:
    """Group (N,) of each patch: all patches of a voxel that look alike, else each one alone.

    Args:
        points, normals: (N, 3).
        colours: (N, C) display values that must agree within `tolerance` (standard deviation).
        cells: voxel edges in metres, coarsest first; what does not fit tries the next.
    """
    group = np.full(len(points), -1, np.int64)
    next_group = 0
    for cell in cells:
        open_ = np.flatnonzero(group < 0)
        if len(open_) == 0:
            break
        _, ids, count = np.unique(
            _directional_voxels(points[open_], normals[open_], cell),
            return_inverse=True, return_counts=True,
        )  # fmt: skip
        mean_normal = _means(ids, normals[open_], count)
        mean = _means(ids, colours[open_], count)
        spread = np.sqrt(np.maximum(_means(ids, colours[open_] ** 2, count) - mean**2, 0)).max(
            axis=1
        )
        flat = np.linalg.norm(mean_normal, axis=1) > 0.985
        good = flat & (spread < tolerance)
        numbers = np.cumsum(good) - 1 + next_group
        group[open_] = np.where(good[ids], numbers[ids], -1)
        next_group += int(good.sum())
    alone = group < 0
    group[alone] = next_group + np.arange(alone.sum())
    return group


def shell_groups(points: Array, normals: Array, cell: float) -> Ints:
    """Group (N,) of each patch by voxel and main direction alone, whatever they look like."""
    group: Ints = np.unique(_directional_voxels(points, normals, cell), return_inverse=True)[1]
    return group


def _directional_voxels(points: Array, normals: Array, cell: float) -> Ints:
    """Voxel number times six plus the main direction of the normal: thin sheets stay apart."""
    axis = np.argmax(np.abs(normals), axis=1)
    sign = np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] > 0
    return voxel_ids(points, cell) * 6 + 2 * axis + sign


def _means(group: Ints, values: Array, count: Ints) -> Array:
    return np.stack(
        [np.bincount(group, weights=column, minlength=len(count)) / count for column in values.T],
        -1,
    )


def group_means(group: Ints, *arrays: Array) -> list[Array]:
    """Mean of each array (N, ...) within each group, (G, ...)."""
    count = np.bincount(group)
    results = []
    for array in arrays:
        columns = array.reshape(len(array), -1)
        results.append(_means(group, columns, count).reshape(len(count), *array.shape[1:]))
    return results


def flat_gaussians(
    group: Ints, points: Array, normals: Array, spacing: Array, sh: Array, opacity: float
) -> Gaussians:
    """One Gaussian a group, as wide as its patches and flat along their mean normal.

    Args:
        group: (N,) from `group_patches`.
        points, normals: (N, 3).
        spacing: (N,) edges of the patches, metres.
        sh: (G, K, 3).
    """
    centre, normal, edge = group_means(group, points, normals, spacing)
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    offset = points - centre[group]
    scatter = group_means(group, offset[:, :, None] * offset[:, None, :])[0]
    scatter += (edge**2 / 12)[:, None, None] * np.eye(3)
    # leave out the normal direction before the main axes are taken
    project = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    values, vectors = np.linalg.eigh(project @ scatter @ project)
    minor, major = np.sqrt(np.maximum(values[:, 1:], 1e-8)).T
    minor = np.maximum(minor, 0.35 * major)
    rotation = np.stack([vectors[:, :, 2], np.cross(normal, vectors[:, :, 2]), normal], axis=-1)
    cover = np.where(np.bincount(group) > 1, COVERAGE[1], COVERAGE[0])
    deviations = np.stack([major * cover, minor * cover, np.full_like(major, _THICKNESS)], -1)

    def tensor(values: Array) -> torch.Tensor:
        return torch.as_tensor(values, dtype=torch.float32)

    return Gaussians(
        means=tensor(centre),
        quats=tensor(se3.matrix_to_quat(rotation)),
        log_scales=tensor(np.log(deviations)),
        logit_opacities=tensor(np.full(len(centre), np.log(opacity / (1 - opacity)))),
        sh=tensor(sh),
    )
