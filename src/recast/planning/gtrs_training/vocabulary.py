"""A vocabulary of our own: plausible driving, sampled, clustered, and the same in the mirror."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.planning.gtrs.loss import DEMONSTRATED
from recast.planning.gtrs.vocabulary import Trajectories
from recast.planning.gtrs_training.driving import braking, cruising, sample_driving

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MIN_SIZE = 64
_SAMPLED = 12_000
_SIDE_SHARE = 0.41
"""Of the vocabulary, entries that lead to the left; as many lead to the right."""
_BRAKING_FROM = np.arange(1.5, 15.1, 1.5)
_BRAKING_WITH = (2.5, 4.0, 6.0)
_CRUISING = np.arange(1.0, 15.1, 1.0)
_ROUNDS = 20
_MIRROR = np.array([1.0, -1.0, -1.0])


def make_vocabulary(size: int = 512, seed: int = 0) -> Trajectories:
    """(size, 40, 3) float32 trajectories, see `read_vocabulary`.

    The first one stands still. Then come straight ones, full stops with up to 6 m/s^2 from any
    speed and constant speeds among them, then those to the left, then their mirror images. All are
    samples of `sample_driving` (medoids), so each can be driven; k-means over eight poses chooses
    them.

    Raises:
        InputError: a size below 64.
    """
    if size < MIN_SIZE:
        raise InputError("vocabulary", "size", f"is {size}", f"give {MIN_SIZE} or more")
    rng = np.random.default_rng(seed)
    side = round(_SIDE_SHARE * size)
    fixed = np.concatenate(
        [*(braking(_BRAKING_FROM, rate) for rate in _BRAKING_WITH), cruising(_CRUISING)]
    )
    straight = size - 1 - 2 * side
    fixed = fixed[:: -(-2 * len(fixed) // straight)]  # at most half of the straight ones
    sampled = sample_driving(_SAMPLED, rng)
    plain = sampled * [1.0, 0.0, 0.0]  # the same speeds, straight on
    # One side is enough: what leads to the right is there as its mirror image.
    leads = sampled[..., 1].sum(axis=1)
    left = np.where(leads[:, None, None] < 0, sampled * _MIRROR, sampled)[leads != 0]
    ahead = np.concatenate([fixed, _medoids(plain, straight - len(fixed), rng)])
    ahead = ahead[np.argsort(ahead[:, -1, 0], kind="stable")]
    turning = _medoids(left, side, rng)
    standing = np.zeros((1, *sampled.shape[1:]))
    # Minus zero is not zero to the last bit.
    vocabulary = np.concatenate([standing, ahead, turning, turning * _MIRROR]) + 0.0
    return vocabulary.astype(np.float32)


def mirrored(trajectories: Trajectories) -> Trajectories:
    """Trajectories (..., 3) as seen in a mirror: y and heading change sign."""
    return (trajectories * _MIRROR.astype(np.float32) + np.float32(0.0)).astype(np.float32)


def mirror_index(vocabulary: Trajectories) -> Index:
    """For each trajectory the index (L,) of its mirror image.

    Raises:
        InputError: a mirror image is not in the vocabulary.
    """
    known = {row.tobytes(): i for i, row in enumerate(vocabulary + np.float32(0.0))}
    found = [known.get(row.tobytes(), -1) for row in mirrored(vocabulary)]
    if -1 in found:
        raise InputError(
            "vocabulary", f"trajectory {found.index(-1)}", "has no mirror image among the others",
            "make one with recast planner vocabulary",
        )  # fmt: skip
    return np.array(found, np.int64)


def _features(trajectories: Array) -> Array:
    """(N, 24): what makes two drives different. A decimetre aside matters near the lane's middle,
    not at the end of a bend; a metre ahead matters little at speed."""
    x, y, heading = np.moveaxis(trajectories[:, DEMONSTRATED], -1, 0)
    parts = (4.0 * np.arcsinh(x / 8.0), 3.0 * np.arcsinh(y), 4.0 * np.arcsinh(4.0 * heading))
    return np.concatenate(parts, axis=1)


def _medoids(trajectories: Array, count: int, rng: np.random.Generator) -> Array:
    """The trajectories nearest to the centres of k-means, each once."""
    points = _features(trajectories)
    centres = points[rng.choice(len(points), count, replace=False)]
    for _ in range(_ROUNDS):
        nearest = _distances(points, centres).argmin(axis=1)
        members = np.bincount(nearest, minlength=count)
        sums = np.stack(
            [np.bincount(nearest, column, minlength=count) for column in points.T], axis=1
        )
        # A centre without members starts anew somewhere.
        fresh = points[rng.choice(len(points), count)]
        centres = np.where(members[:, None] > 0, sums / np.maximum(members, 1)[:, None], fresh)
    chosen: list[int] = []
    taken = np.zeros(len(points), np.bool_)
    for column in _distances(points, centres).T:
        best = int(np.where(taken, np.inf, column).argmin())
        chosen.append(best)
        # Equal ones count as taken too: straight profiles repeat.
        taken |= (trajectories == trajectories[best]).all(axis=(1, 2))
    return trajectories[chosen]


def _distances(points: Array, centres: Array) -> Array:
    """Squared, (N, K)."""
    squares = (points**2).sum(axis=1)[:, None] + (centres**2).sum(axis=1)
    found: Array = squares - 2.0 * points @ centres.T
    return found
