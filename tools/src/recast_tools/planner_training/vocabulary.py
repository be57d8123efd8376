"""A vocabulary of our own: plausible driving, sampled, clustered, and the same in the mirror.

Driving is four seconds of smooth speeds, bends and lane shifts within limits. Most of it is
comfortable as the metric COM counts it; the rest is for emergencies.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array, Int64Array
from recast.core.errors import InputError
from recast.dynamics.tracker import comfortable_plans
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
_END_JERK = 7.0
"""m/s^3 with which sampled drives come to a halt or reach the top speed. COM allows 8.37."""
_TIMES = _DT * np.arange(WAYPOINTS + 1)

MIN_SIZE = 64
_SAMPLED = 12_000
_SIDE_SHARE = 0.36
"""Share of the vocabulary's entries that lead to the left; as many lead to the right."""
_FIXED_SHARE = 0.75
"""Maximum share of the straight entries that are not chosen by k-means."""
_EMERGENCY_SHARE = 0.15
"""Share of the sampled entries that are not comfortable: hard braking and swerving."""
_STOPS_FROM = np.arange(1.5, 15.1, 1.5)
_HARD_STOPS = (4.0, 6.0)
_SMOOTH_STOPS = ((1.5, 0.0), (2.5, 0.0), (2.5, 0.8), (2.5, None), (3.8, 0.0), (3.8, None))
"""Deceleration, m/s^2, and delay, s; None: the vehicle brakes already."""
_SLOWED_FROM, _SLOWED_TO = np.arange(3.0, 15.1, 3.0), 0.5
_SLOW_DOWNS = ((2.0, 0.0), (2.0, None))
_CRUISING = np.arange(1.0, 15.1, 1.0)
_ROUNDS = 20
_MIRROR = np.array([1.0, -1.0, -1.0])


def make_vocabulary(size: int = 512, seed: int = 0) -> Trajectories:
    """(size, 40, 3) float32 trajectories, see `read_vocabulary`.

    The first one stands still. Then come straight ones: full stops with 4 and 6 m/s^2 for
    emergencies, smooth stops and slow-downs, constant speeds, and sampled ones. Then come those to
    the left, then their mirror images. k-means over eight poses chooses from `sample_driving`
    (medoids, so each can be driven); 85 % of these are comfortable, see `comfortable_plans`.

    Raises:
        InputError: a size below 64.
    """
    if size < MIN_SIZE:
        raise InputError("vocabulary", "size", f"is {size}", f"give {MIN_SIZE} or more")
    rng = np.random.default_rng(seed)
    side = round(_SIDE_SHARE * size)
    fixed = np.concatenate(
        [
            *(braking(_STOPS_FROM, rate) for rate in _HARD_STOPS),
            *(smooth_braking(_STOPS_FROM, rate, delay) for rate, delay in _SMOOTH_STOPS),
            *(
                smooth_braking(_SLOWED_FROM, rate, delay, _SLOWED_TO * _SLOWED_FROM)
                for rate, delay in _SLOW_DOWNS
            ),
            cruising(_CRUISING),
        ]
    )
    straight = size - 1 - 2 * side
    fixed = fixed[:: int(np.ceil(len(fixed) / (_FIXED_SHARE * straight)))]
    sampled = sample_driving(_SAMPLED, rng)
    plain = sampled * [1.0, 0.0, 0.0]  # the same speeds, straight on
    # One side is enough: what leads to the right is there as its mirror image.
    leads = sampled[..., 1].sum(axis=1)
    left = np.where(leads[:, None, None] < 0, sampled * _MIRROR, sampled)[leads != 0]
    ahead = np.concatenate([fixed, _mostly_comfortable(plain, straight - len(fixed), rng)])
    ahead = ahead[np.argsort(ahead[:, -1, 0], kind="stable")]
    turning = _mostly_comfortable(left, side, rng)
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
            "make a vocabulary with `recast planner vocabulary`",
        )
    return np.array(found, np.int64)


def _features(trajectories: Array) -> Array:
    """(N, 24): what makes two drives different. A decimetre aside matters near the lane's middle,
    not at the end of a bend; a metre ahead matters little at speed."""
    x, y, heading = np.moveaxis(trajectories[:, DEMONSTRATED], -1, 0)
    parts = (4.0 * np.arcsinh(x / 8.0), 3.0 * np.arcsinh(y), 4.0 * np.arcsinh(4.0 * heading))
    return np.concatenate(parts, axis=1)


def _mostly_comfortable(trajectories: Array, count: int, rng: np.random.Generator) -> Array:
    """`count` medoids, of which `_EMERGENCY_SHARE` are not comfortable."""
    # As stored: rounding changes the differences by which comfort is judged.
    comfortable = comfortable_plans(trajectories.astype(np.float32))
    emergencies = round(_EMERGENCY_SHARE * count)
    return np.concatenate(
        [
            _medoids(trajectories[comfortable], count - emergencies, rng),
            _medoids(trajectories[~comfortable], emergencies, rng),
        ]
    )


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
    return _straight(np.maximum(_integrated(speeds, np.tile(wanted, (np.size(speeds), 1))), 0.0))


def smooth_braking(
    speeds: ArrayLike, rate: float, delay: float | None = 0.0, to: ArrayLike = 0.0
) -> Array:
    """(N, 40, 3) straight and comfortable braking from speeds (N,) in m/s.

    The deceleration grows and ends linearly: with 4 m/s^3, or 8 if it is above 2.5 m/s^2.

    Args:
        rate: maximum deceleration, m/s^2; less where the change of speed is too small for it.
        delay: seconds at constant speed before; None: it brakes with the maximum already.
        to: (N,) speed at the end, m/s, if 4 s suffice.
    """
    start: Array = np.reshape(np.asarray(speeds, np.float64), (-1, 1))
    jerk = 4.0 if rate <= 2.5 else 8.0
    begin: Array
    change: Array = start - np.reshape(to, (-1, 1))
    if delay is None:
        peak = np.minimum(rate, np.sqrt(2 * jerk * change))
        ramp = peak / jerk
        change, begin = change + peak * ramp / 2, -ramp  # the first ramp lies in the past
    else:
        peak = np.minimum(rate, np.sqrt(jerk * change))
        ramp, begin = peak / jerk, np.full_like(start, delay)
    held = change / peak - ramp

    def lost(times: ArrayLike) -> Array:
        knots = (begin, begin + ramp, begin + ramp + held, begin + 2 * ramp + held)
        signs = (1.0, -1.0, -1.0, 1.0)
        t = np.asarray(times, np.float64)
        parts = [s * np.maximum(t - k, 0.0) ** 2 for s, k in zip(signs, knots, strict=True)]
        return np.asarray(jerk / 2 * np.sum(parts, axis=0), np.float64)

    # Where the braking has ended, rounding leaves next to nothing of either sign.
    speed: Array = start + lost(0.0) - lost(_TIMES)
    return _straight(np.maximum(speed, 0.0))


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
    acceleration = rates[0][:, None] + (rates[1] - rates[0])[:, None] * ramp
    return _within(_integrated(start, acceleration), acceleration)


def _integrated(start: ArrayLike, acceleration: Array) -> Array:
    """Speeds (N, 41) from speeds (N,) and accelerations (N, 41)."""
    means = (acceleration[:, 1:] + acceleration[:, :-1]) / 2
    gained = np.concatenate([np.zeros((len(means), 1)), np.cumsum(_DT * means, axis=1)], axis=1)
    return np.reshape(start, (-1, 1)) + gained


def _within(speed: Array, acceleration: Array) -> Array:
    """Speeds (N, 41) bent smoothly so that they stay between standing and the top speed."""
    pull, brake = acceleration.max(axis=1), -acceleration.min(axis=1)
    bent = _TOP_SPEED - _above_zero(_TOP_SPEED - speed, np.maximum(pull, 0.0))
    return _above_zero(bent, np.maximum(brake, 0.0))


def _above_zero(speed: Array, rate: Array) -> Array:
    """A parabola joins speeds (N, 41) that fall at a rate (N,) and zero, with `_END_JERK`."""
    width = np.maximum(rate**2 / (2 * _END_JERK), 1e-9)[:, None]
    joined = np.clip(speed + width, 0.0, None) ** 2 / (4 * width)
    return np.where(speed < width, joined, speed)


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
