"""Pairs of rollouts of the same scenario under two arms, and the bootstrap of their difference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from math import factorial
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.dynamics.state import moved_left
from recast.metrics.table import Attempt, Metric, Scored
from recast.simulation.rollout import Rollout

_Key = tuple[str, str | None, str, str]

Rollouts = TypeVar("Rollouts", bound=Scored)
SAMPLES = 200_000
_PIECE = 10_000
"""Samples that are drawn at a time."""
MOST_EXACT = 11
"""Scenes up to which the exact distribution is enumerated: 352,716 multisets."""


@dataclass(frozen=True)
class Pair:
    """Two rollouts of a scenario, both up to the end of the shorter.

    Attributes:
        candidate, baseline: their metrics up to there.
        plans: how many plans each made up to there.
        cut: whether one of them went on for longer.
    """

    candidate: Mapping[str, Metric]
    baseline: Mapping[str, Metric]
    plans: int
    cut: bool


@dataclass(frozen=True)
class PairedMetric:
    """Candidate minus baseline of one metric, over the pairs in which both have a value.

    Attributes:
        differences: (n,) differences by scene, plain values; scenes without a pair are left out.
        pairs: number of these pairs.
        plans: how many plans each side made in them.
        cut: how many of the pairs end where one of the two rollouts was cut.
        asked: scenarios that either arm was asked for, failed rollouts among them.
    """

    differences: Mapping[str, Array]
    pairs: int
    plans: int
    cut: int
    asked: int


@dataclass(frozen=True)
class Pairs:
    """All pairs of two arms.

    Attributes:
        by_scene: pairs by name of the scene.
        asked: see `PairedMetric`.
    """

    by_scene: Mapping[str, tuple[Pair, ...]]
    asked: int

    def of(self, metric: str) -> PairedMetric:
        """One metric, a key of `recast.metrics.table.COLUMNS`."""
        differences: dict[str, Array] = {}
        used: list[Pair] = []
        for scene, pairs in self.by_scene.items():
            values = []
            for pair in pairs:
                one, other = pair.candidate[metric].value, pair.baseline[metric].value
                if one is not None and other is not None:
                    values.append(one - other)
                    used.append(pair)
            if values:
                differences[scene] = np.array(values)
        return PairedMetric(
            differences=differences,
            pairs=len(used),
            plans=sum(pair.plans for pair in used),
            cut=sum(pair.cut for pair in used),
            asked=self.asked,
        )


def matched_pairs(
    scored: Mapping[str, Sequence[Scored]],
    candidate: str,
    baseline: str,
    failed: Mapping[str, Sequence[Attempt]] | None = None,
) -> Pairs:
    """Match rollouts of two arms by planner, track, motion and setting.

    A rollout that was cut had fewer chances to fail than one that was not: each pair is compared
    up to the end of its shorter rollout.

    Args:
        scored: rollouts by name of the scene; those of other arms are ignored.
        candidate, baseline: arms.
        failed: rollouts that ended in an error: they have no pair, but were asked for.
    """
    by_scene: dict[str, tuple[Pair, ...]] = {}
    asked: set[tuple[str, _Key]] = set()
    for scene, attempts in (failed or {}).items():
        asked |= {(scene, _key(a)) for a in attempts if a.arm in (candidate, baseline)}
    for scene, rollouts in scored.items():
        found: dict[str, dict[_Key, Scored]] = {candidate: {}, baseline: {}}
        for rollout in rollouts:
            if rollout.arm in found:
                found[rollout.arm][_key(rollout)] = rollout
                asked.add((scene, _key(rollout)))
        shared = [key for key in found[candidate] if key in found[baseline]]
        if shared:
            by_scene[scene] = tuple(
                _pair(found[candidate][key], found[baseline][key]) for key in shared
            )
    return Pairs(by_scene, len(asked))


def over_common_steps(one: Rollouts, other: Rollouts) -> tuple[Rollouts, Rollouts]:
    """Both rollouts up to the end of the shorter."""
    assert one.steps_run is not None and other.steps_run is not None  # both were scored
    steps = min(one.steps_run, other.steps_run)
    return one.over(steps), other.over(steps)


def _pair(candidate: Scored, baseline: Scored) -> Pair:
    one, other = over_common_steps(candidate, baseline)
    return Pair(
        candidate=one.values,
        baseline=other.values,
        plans=min(one.plans, other.plans),
        cut=candidate.steps_run != baseline.steps_run,
    )


def _key(attempt: Attempt) -> _Key:
    return attempt.planner, attempt.track_id, attempt.motion, attempt.setting


def script_difference(one: Rollout, other: Rollout, left: float = 0.0) -> str | None:
    """What differs that no arm may change, in words; None where nothing does.

    The states of scripted actors are compared up to the end of the shorter: where its ego leaves
    the road decides how long a rollout is. Of actors that react only the first state is compared.

    Args:
        left: metres to the left of the start of `one` at which `other` is to start.
    """
    for field in ("track_id", "start_timestamp_us", "dt", "steps_requested", "ego_centre_offset"):
        if getattr(one, field) != getattr(other, field):
            return f"{field} differs: {getattr(one, field)}, not {getattr(other, field)}"
    for field in ("actor_size", "ego_size", "route"):
        if not np.array_equal(getattr(one, field), getattr(other, field)):
            return f"{field} differs"
    start = moved_left(one.ego[0], left) if left else one.ego[0]
    if not np.array_equal(start, other.ego[0]):
        return "the ego's first state differs"
    ids = [[r.track_id, *(actor.track_id for actor in r.controlled)] for r in (one, other)]
    if ids[0] != ids[1] or one.reactive != other.reactive:
        return "the controlled actors differ"
    for track_id, states, others in zip(ids[0], _states(one), _states(other), strict=True):
        common = 1 if track_id in one.reactive else min(len(states), len(others))
        apart = np.flatnonzero((states[:common] != others[:common]).any(axis=1))
        if len(apart):
            who = "the actor" if track_id == one.track_id else f"actor {track_id}"
            return f"{who}'s states differ from step {apart[0]} on"
    return None


def _states(rollout: Rollout) -> list[np.ndarray]:
    """States and poses (S+1, 20) of each controlled actor, the target first."""
    actors = [(rollout.actor, rollout.world_from_actor)]
    actors += [(actor.states, actor.world_from_actor) for actor in rollout.controlled]
    return [np.hstack([states, poses.reshape(-1, 16)]) for states, poses in actors]


@dataclass(frozen=True)
class Bootstrap:
    """The distribution of a resampled mean.

    Attributes:
        point: the mean of the data.
        low, high: the interval that holds `level` of the distribution.
        mean, std: mean and standard deviation of the distribution.
        level: share of the distribution in the interval, for example 0.95.
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
        scenes: differences (n_i,) of the pairs of each scene, e.g. candidate minus baseline.
            Scenes may have different numbers of pairs; sums are divided by counts after summing.
        rng: random generator, drawn from as `integers(0, len(scenes), (samples, len(scenes)))`, in
            pieces, so that hundreds of scenes do not take gigabytes.

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
        raise ValueError(
            "bootstrap: expected at least one scene, with at least one pair in every scene"
        )
    return np.array([a.sum() for a in arrays]), np.array([float(len(a)) for a in arrays])
