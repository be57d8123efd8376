"""Frechet distance of two clouds of features, as FID measures it (Heusel et al. 2017, eq. 6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def frechet_distance(first: ArrayLike, second: ArrayLike) -> float:
    """|m1 - m2|^2 + tr(S1 + S2 - 2 (S1 S2)^(1/2)) of Gaussians fitted to two sets of features.

    No matrix root is taken. With centred rows divided by sqrt(n - 1), S1 = A'A and S2 = B'B, and
    the eigenvalues of S1 S2 = A'A B'B other than zero are the squared singular values of A B': the
    trace of the root is their sum. It is real and not negative whatever the rank, and nothing is
    squared on the way; the usual root of a product of covariances has neither virtue where there
    are fewer pictures than dimensions.

    A fit to few pictures makes the distance too large, by about a share of dimensions over
    pictures, so that only distances over equally many pictures compare.

    Args:
        first, second: (n, D) and (m, D), at least two rows each.

    Returns:
        At least 0, in squared units of the features; 0 for equal sets.

    Raises:
        ValueError: fewer than two rows, or other shapes.
    """
    one, two = np.asarray(first, np.float64), np.asarray(second, np.float64)
    if one.ndim != 2 or two.ndim != 2 or one.shape[1] != two.shape[1]:
        raise ValueError(f"frechet_distance: features of shapes {one.shape} and {two.shape}")
    if min(len(one), len(two)) < 2:
        raise ValueError(f"frechet_distance: {len(one)} and {len(two)} pictures, needs 2 each")
    a, b = _factor(one), _factor(two)
    apart = one.mean(axis=0) - two.mean(axis=0)
    roots = np.linalg.svd(a @ b.T, compute_uv=False).sum()
    distance = float(apart @ apart + (a * a).sum() + (b * b).sum() - 2 * roots)
    return max(distance, 0.0)


def _factor(features: Array) -> Array:
    """(k, D) with k <= D whose product with itself, transposed first, is the covariance."""
    centred = (features - features.mean(axis=0)) / np.sqrt(len(features) - 1)
    if len(centred) <= centred.shape[1]:
        return centred
    return np.asarray(np.linalg.qr(centred, mode="r"), np.float64)
