"""Which Gaussians a page gets: those that cover most of what one sees along the drive."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recast.splats import Gaussians

Array = NDArray[np.float64]

NEAREST = 3.0
"""Metres; what is nearer to the path counts as if it were this far."""
ACTOR_DISTANCE = 8.0
"""Metres at which actors are looked at, for their importance beside that of the street."""


def importance(gaussians: Gaussians, distances: Array) -> Array:
    """Opacity times the area of each Gaussian's largest section over its squared distance: (N,).

    Args:
        distances: (N,) metres to the path from which it is looked at; below `NEAREST`, that.
    """
    sigmas = gaussians.log_scales.detach().double().exp().sort(dim=1).values
    opacity = torch.sigmoid(gaussians.logit_opacities.detach().double())
    area = (opacity * sigmas[:, 1] * sigmas[:, 2]).numpy()
    found: Array = area / np.maximum(distances, NEAREST) ** 2
    return found


def path_distances(gaussians: Gaussians, path: Array) -> Array:
    """Metres (N,) from each centre to the nearest of the points (P, 3); `NEAREST` without any."""
    if len(path) == 0:
        return np.full(len(gaussians), NEAREST)
    distances, _ = cKDTree(path).query(gaussians.means.detach().double().numpy())
    return np.asarray(distances, np.float64)


def most_important(values: Sequence[Array], most: int) -> list[NDArray[np.int64]]:
    """Rows to keep of each of several arrays, `most` altogether, the most important ones.

    Rows stay in their order. Equal ones: the earlier array and row first.
    """
    sizes = [len(part) for part in values]
    if sum(sizes) <= most:
        return [np.arange(size) for size in sizes]
    ranking = np.argsort(-np.concatenate(values), kind="stable")[: max(most, 0)]
    kept = np.zeros(sum(sizes), bool)
    kept[ranking] = True
    starts = np.cumsum(sizes)[:-1]
    return [np.flatnonzero(part) for part in np.split(kept, starts)]
