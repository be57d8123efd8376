"""Frechet distance of two clouds of features, as FID measures it (Heusel et al. 2017, eq. 6)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import blas, lapack

from recast.arrays import Array


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
        raise ValueError(f"frechet_distance: feature shapes {one.shape} and {two.shape} differ")
    if min(len(one), len(two)) < 2:
        raise ValueError(
            f"frechet_distance: {len(one)} and {len(two)} images, expected at least 2 each"
        )
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


@dataclass(frozen=True)
class FeatureStats:
    """What the Frechet distance needs of a set of features, so that the features can go.

    Attributes:
        count: number of pictures; 0 is allowed.
        mean: (D,) mean of the pictures' features.
        scatter: (D, D) sum of the outer products of features less their mean.
    """

    count: int
    mean: Array
    scatter: Array

    @classmethod
    def of(cls, features: ArrayLike) -> FeatureStats:
        """The statistics of features (n, D)."""
        rows = np.asarray(features, np.float64)
        mean = rows.mean(axis=0) if len(rows) else np.zeros(rows.shape[1])
        return cls(len(rows), mean, (rows - mean).T @ (rows - mean))

    @classmethod
    def merged(
        cls, groups: Iterable[FeatureStats], times: Sequence[int] | None = None
    ) -> FeatureStats:
        """The statistics of all groups together, each taken a number of times (once by default).

        Scatters add up, with the outer product of each group's mean less the common mean (Chan et
        al. 1979). Sums of raw outer products would cancel where means are large.

        Raises:
            ValueError: there is no picture.
        """
        groups = list(groups)
        times = [1] * len(groups) if times is None else times
        used = [(many, one) for many, one in zip(times, groups, strict=True) if many * one.count]
        count = sum(many * one.count for many, one in used)
        if not count:
            raise ValueError("FeatureStats.merged: there are no images")
        shares = np.array([many * one.count for many, one in used], np.float64)
        means = np.stack([one.mean for _, one in used])
        mean = shares @ means / count
        spread = np.sqrt(shares)[:, None] * (means - mean)
        scatter = spread.T @ spread
        for many, one in used:
            scatter += many * one.scatter
        return cls(count, mean, scatter)


def frechet_between(first: FeatureStats, second: FeatureStats) -> float:
    """`frechet_distance` from statistics alone.

    Of the covariance of the smaller set, a Cholesky factor L with pivots is taken: (D, r) for rank
    r, which fewer pictures than dimensions make small. The eigenvalues of L' S L, with S the other
    covariance, are those of S1 S2. They are squares of what `frechet_distance` finds, so that
    rounding may move the result by up to about D (eps tr(S1) tr(S2))^(1/2), eps of float64. With
    2048 features of 900 to 6,000 made-up pictures the two agree to 12 digits; this one takes 1 to 2
    seconds on one core, a fifth of the other's time.

    Raises:
        ValueError: a set has fewer than two pictures.
    """
    few, many = sorted((first, second), key=lambda stats: stats.count)
    if few.count < 2:
        raise ValueError(
            f"frechet_between: {first.count} and {second.count} images, expected at least 2 each"
        )
    covariances = [stats.scatter / (stats.count - 1) for stats in (few, many)]
    packed, order, rank, _ = lapack.dpstrf(covariances[0], lower=1)
    factor, order = np.tril(packed), order - 1
    other = covariances[1][np.ix_(order, order)]
    if rank == len(factor):  # twice as fast
        product = blas.dtrmm(1.0, factor, blas.dtrmm(1.0, factor, other, 1, 1), 0, 1, 1)
    else:
        product = factor[:, :rank].T @ (other @ factor[:, :rank])
    # Those of torch are the fastest of numpy's, scipy's and torch's.
    squares = torch.linalg.eigvalsh(torch.from_numpy(np.ascontiguousarray(product))).numpy()
    roots = float(np.sqrt(np.maximum(squares, 0.0)).sum())
    apart = first.mean - second.mean
    spread = sum(float(np.trace(one)) for one in covariances)
    return max(float(apart @ apart) + spread - 2 * roots, 0.0)


def frechet_bootstrap(
    first: Mapping[str, FeatureStats], second: Mapping[str, FeatureStats], draws: NDArray[np.int64]
) -> Array:
    """(K,) distances of two sets whose scenes are drawn together, with replacement.

    A draw costs one `frechet_between`. Draws of the same scenes are computed once, and rows do not
    depend on each other: workers may share them.

    Args:
        first, second: statistics of the two sets by scene; both have the same scenes.
        draws: (K, n) positions in the sorted names of the scenes, as of
            `rng.integers(0, n, (K, n))`; one array for all arms makes their differences paired.

    Raises:
        ValueError: other scenes in the one than in the other, or a draw in which a set has fewer
            than two pictures.
    """
    names = sorted(first)
    if names != sorted(second):
        raise ValueError(f"frechet_bootstrap: scenes differ: {names} and {sorted(second)}")
    times = (draws[:, :, None] == np.arange(len(names))).sum(axis=1)
    kinds, which = np.unique(times, axis=0, return_inverse=True)
    sets = [[one[name] for name in names] for one in (first, second)]
    found = [frechet_between(*(FeatureStats.merged(one, kind) for one in sets)) for kind in kinds]
    return np.array(found)[which.reshape(-1)]
