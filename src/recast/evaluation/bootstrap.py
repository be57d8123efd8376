"""Confidence of a paired difference: scenes are drawn, their rollouts stay together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from math import factorial

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array

SAMPLES = 200_000
_PIECE = 10_000
"""Samples that are drawn at a time."""
MOST_EXACT = 11
"""Scenes up to which the exact distribution is enumerated: 352,716 multisets."""


@dataclass(frozen=True)
class Bootstrap:
    """The distribution of a resampled mean.

    Attributes:
        point: the mean of the data.
        low, high: the interval that holds `level` of the distribution.
        mean, std: of the distribution.
        level: for example 0.95.
    """

    point: float
    low: float
    high: float
    mean: float
    std: float
    level: float


def cluster_bootstrap(
    scenes: Sequence[ArrayLike],
    rng: np.random.Generator,
    samples: int = SAMPLES,
    level: float = 0.95,
) -> Bootstrap:
    """Percentile bootstrap over whole scenes.

    Args:
        scenes: for each scene, the differences (n_i,) of its pairs, e.g. candidate minus baseline.
            Scenes may have different numbers of pairs; sums are divided by counts after summing.
        rng: drawn from as `integers(0, len(scenes), (samples, len(scenes)))`, in pieces, so that
            hundreds of scenes do not take gigabytes.

    Raises:
        ValueError: there is no scene, or one without a pair.
    """
    sums, counts = _sums_and_counts(scenes)
    pieces = []
    for start in range(0, samples, _PIECE):
        index = rng.integers(0, len(sums), (min(_PIECE, samples - start), len(sums)))
        pieces.append(sums[index].sum(axis=1) / counts[index].sum(axis=1))
    means = np.concatenate(pieces)
    tail = 50 * (1 - level)
    low, high = np.percentile(means, [tail, 100 - tail])
    return Bootstrap(
        float(sums.sum() / counts.sum()),
        float(low),
        float(high),
        float(means.mean()),
        float(means.std()),
        level,
    )


def exact_bootstrap(scenes: Sequence[ArrayLike], level: float = 0.95) -> Bootstrap:
    """The same without chance: every multiset of scenes with its multinomial probability.

    A quantile is the least value whose cumulative probability reaches it.

    Raises:
        ValueError: no scene, one without a pair, or too many scenes to enumerate (above 11).
    """
    sums, counts = _sums_and_counts(scenes)
    n = len(sums)
    if n > MOST_EXACT:
        raise ValueError(f"exact_bootstrap: {n} scenes are too many to enumerate; sample instead")
    multisets = np.array(list(combinations_with_replacement(range(n), n)))
    times = np.stack([(multisets == scene).sum(axis=1) for scene in range(n)], axis=1)
    factorials = np.array([float(factorial(k)) for k in range(n + 1)])
    probability = factorials[n] / factorials[times].prod(axis=1) / float(n) ** n
    values = (times @ sums) / (times @ counts)
    order = np.argsort(values, kind="stable")
    cumulative = np.cumsum(probability[order])
    tail = (1 - level) / 2
    low, high = (
        values[order][np.searchsorted(cumulative, quantile - 1e-12)]
        for quantile in (tail, 1 - tail)
    )
    mean = float(probability @ values)
    std = float(np.sqrt(probability @ (values - mean) ** 2))
    return Bootstrap(float(sums.sum() / counts.sum()), float(low), float(high), mean, std, level)


def _sums_and_counts(scenes: Sequence[ArrayLike]) -> tuple[Array, Array]:
    arrays = [np.atleast_1d(np.asarray(scene, np.float64)) for scene in scenes]
    if not arrays or any(len(a) == 0 for a in arrays):
        raise ValueError("bootstrap: needs a scene, and a pair in every scene")
    return np.array([a.sum() for a in arrays]), np.array([float(len(a)) for a in arrays])
