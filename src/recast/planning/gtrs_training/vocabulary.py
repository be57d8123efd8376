"""A vocabulary of our own: plausible driving, sampled, clustered, and the same in the mirror.

Driving is four seconds of smooth speeds, bends and lane shifts within limits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array, Int64Array
from recast.core.errors import InputError
from recast.planning.gtrs.scores import DEMONSTRATED, Trajectories
from recast.planning.types import WAYPOINTS

_DT = 0.1
_TOP_SPEED = 15.0
_SIDEWAYS = 4.0
"""m/s^2 of lateral acceleration at most, of bends and of shifts each."""
_SHARPEST = 0.16
"""1/m."""
_BRAKES, _PULLS = -6.0, 2.4
_BITE = 0.3
"""Seconds in which a full braking builds up."""
_TIMES = _DT * np.arange(WAYPOINTS + 1)

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


def mirror_index(vocabulary: Trajectories) -> Int64Array:
    """For each trajectory the index (L,) of its mirror image.

    Raises:
        InputError: a mirror image is not in the vocabulary.
    """
    known = {row.tobytes(): i for i, row in enumerate(vocabulary + np.float32(0.0))}
    found = [known.get(row.tobytes(), -1) for row in mirrored(vocabulary)]
    if -1 in found:
        raise InputError(
            "vocabulary",
            f"trajectory {found.index(-1)}",
            "has no mirror image among the others",
            "make one with recast planner vocabulary",
        )
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
    return squares - 2.0 * points @ centres.T


def sample_driving(count: int, rng: np.random.Generator) -> Array:
    """(count, 40, 3) x, y, heading of the rear axle at 0.1 s .. 4 s, starting at the origin.

    Speeds from 0 to 15 m/s, accelerations from -6 to 2.4 m/s^2 with smooth ramps; a quarter
    straight, the others with a bend, a shift of up to a lane, or both. The heading is the path's:
    a vehicle's rear axle moves along its heading.
    """
    speed = _speeds(count, rng)
    kind = rng.uniform(size=count)
    bends, shifts = kind > 0.6, (kind > 0.25) & (kind < 0.85)
    s = _path_lengths(speed)
    shift = np.where(shifts, rng.uniform(-1, 1, count) * rng.choice([0.6, 1.8, 3.8], count), 0.0)
    over = np.maximum(rng.uniform(1.2, 4.0, count) * np.maximum(speed[:, 0], speed[:, 20]), 5.0)
    fastest = speed.max(axis=1)
    # The quintic's greatest curvature is 5.77 w / l^2.
    shift = np.clip(
        shift,
        *np.array([-1, 1])[:, None] * _SIDEWAYS * over**2 / (5.77 * np.maximum(fastest, 1.0) ** 2),
    )
    shift = np.clip(shift, -0.2 * over, 0.2 * over)
    limit = np.minimum(_SIDEWAYS / np.maximum(fastest, 1.0) ** 2, _SHARPEST)
    ends = rng.uniform(-1, 1, (2, count)) * limit * bends
    ends[0] = np.where(rng.uniform(size=count) < 0.5, ends[1], ends[0])
    base, curvature = _bend(s, ends)
    u = np.clip(s / over[:, None], 0.0, 1.0)
    aside = shift[:, None] * u**3 * (10 - 15 * u + 6 * u**2)
    slope = shift[:, None] * u**2 * (30 - 60 * u + 30 * u**2) / over[:, None]
    heading = base[..., 2]
    x = base[..., 0] - aside * np.sin(heading)
    y = base[..., 1] + aside * np.cos(heading)
    heading = heading + np.arctan2(slope, 1.0 - curvature * aside)
    return np.stack([x, y, heading], axis=-1)[:, 1:]


def braking(speeds: ArrayLike, rate: float) -> Array:
    """(N, 40, 3) straight full stops from speeds (N,) in m/s with a deceleration in m/s^2."""
    wanted = -rate * np.minimum(_TIMES / _BITE, 1.0)
    return _straight(_integrated(speeds, np.tile(wanted, (np.size(speeds), 1))))


def cruising(speeds: ArrayLike) -> Array:
    """(N, 40, 3) straight on at constant speeds (N,) in m/s."""
    return _straight(_integrated(speeds, np.zeros((np.size(speeds), WAYPOINTS + 1))))


def _straight(speed: Array) -> Array:
    s = _path_lengths(speed)
    zero = np.zeros_like(s)
    return np.stack([s, zero, zero], axis=-1)[:, 1:]


def _speeds(count: int, rng: np.random.Generator) -> Array:
    """(count, 41) m/s."""
    start = np.where(rng.uniform(size=count) < 0.08, 0.0, rng.uniform(0.0, _TOP_SPEED, count))
    kind = rng.uniform(size=(2, count))
    rates = np.select(
        [kind < 0.25, kind < 0.7],
        [np.zeros((2, count)), rng.uniform(-3.0, _PULLS, (2, count))],
        rng.uniform(_BRAKES, 0.0, (2, count)),
    )
    rates[1] = np.where(rng.uniform(size=count) < 0.5, rates[0], rates[1])
    begin, takes = rng.uniform(0.0, 2.0, count), rng.uniform(0.5, 1.5, count)
    u = np.clip((_TIMES - begin[:, None]) / takes[:, None], 0.0, 1.0)
    ramp = u**2 * (3 - 2 * u)
    return _integrated(start, rates[0][:, None] + (rates[1] - rates[0])[:, None] * ramp)


def _integrated(start: ArrayLike, acceleration: Array) -> Array:
    """Speeds (N, 41) that stay between standing and the top speed."""
    speed = np.empty(acceleration.shape)
    speed[:, 0] = start
    for k in range(WAYPOINTS):
        mean = (acceleration[:, k] + acceleration[:, k + 1]) / 2
        speed[:, k + 1] = np.clip(speed[:, k] + _DT * mean, 0.0, _TOP_SPEED)
    return speed


def _path_lengths(speed: Array) -> Array:
    """Metres (N, 41) driven at speeds (N, 41)."""
    steps = _DT * (speed[:, :-1] + speed[:, 1:]) / 2
    return np.concatenate([np.zeros((len(speed), 1)), np.cumsum(steps, axis=1)], axis=1)


def _bend(s: Array, ends: Array) -> tuple[Array, Array]:
    """Poses (N, 41, 3) and curvatures (N, 41) of clothoids, from `ends[0]` to `ends[1]`."""
    length = np.maximum(s[:, -1:], 1e-6)
    slope = (ends[1] - ends[0])[:, None] / length
    heading = ends[0][:, None] * s + slope * s**2 / 2
    middle, steps = (heading[:, 1:] + heading[:, :-1]) / 2, np.diff(s, axis=1)
    zero = np.zeros((len(s), 1))
    x = np.concatenate([zero, np.cumsum(steps * np.cos(middle), axis=1)], axis=1)
    y = np.concatenate([zero, np.cumsum(steps * np.sin(middle), axis=1)], axis=1)
    return np.stack([x, y, heading], axis=-1), ends[0][:, None] + slope * s
