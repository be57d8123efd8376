"""Metrics with their validity, the table of means by planner and arm, and pairs of rollouts.

Pairs are rollouts of the same scenario under two arms; the bootstrap of their difference draws
whole scenes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from itertools import combinations_with_replacement
from math import factorial
from typing import Any, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array
from recast.dynamics.state import moved_left
from recast.simulation.rollout import Rollout

DECIMALS = 6


@dataclass(frozen=True)
class Metric:
    """A metric of one rollout.

    Attributes:
        value: the number, or None where it cannot be told (no map, no plan, no route).
        reason: reason in words why the value is not the best possible or why there is none; None
            where there is nothing to explain.
    """

    value: float | None
    reason: str | None = None

    @property
    def valid(self) -> bool:
        """Whether there is a value."""
        return self.value is not None

    def to_json(self) -> dict[str, Any]:
        """Plain value, validity and reason."""
        return {"value": self.value, "valid": self.valid, "reason": self.reason}


def invalid(reason: str) -> Metric:
    """A metric without a value."""
    return Metric(None, reason)


def rounded(value: Any) -> Any:
    """Plain data with floats of six decimals; JSON knows no NaN and no infinity: they are null."""
    if isinstance(value, Mapping):
        return {key: rounded(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(one) for one in value]
    if isinstance(value, float):
        return round(value, DECIMALS) if math.isfinite(value) else None
    return value


@dataclass(frozen=True)
class Column:
    """How a metric is shown.

    Attributes:
        scale: shown value = scale * value.
        headline: whether the metric stands in the short tables: the paper's five metrics, and what
            was driven beside what was planned.
        passes: whether a rollout passes or fails: tables show how many of how many.
    """

    label: str
    unit: str
    scale: float
    headline: bool
    passes: bool = False

    @property
    def heading(self) -> str:
        """Label and unit, in two lines if the label has two words."""
        return f"{self.label} {self.unit}".replace(" ", "\n", int(" " in self.label))

    def shown(self, metric: Metric) -> str:
        """The value in the column's unit, with two decimals; "n/a" if there is none."""
        return "n/a" if metric.value is None else f"{self.scale * metric.value:.2f}"


COLUMNS: Mapping[str, Column] = {
    "nc": Column("NC", "%", 100.0, True, passes=True),
    "nc_at_fault": Column("NC at fault", "%", 100.0, False, passes=True),
    "dac": Column("DAC", "%", 100.0, True, passes=True),
    "ttc": Column("TTC", "s", 1.0, True),
    "r_c": Column("R_c", "%", 100.0, True),
    "com": Column("COM", "%", 100.0, True),
    "com_driven": Column("COM driven", "%", 100.0, True, passes=True),
    "no_phantom_braking": Column("no phantom braking", "%", 100.0, False, passes=True),
    "ttc_constant_velocity": Column("TTC (constant velocity)", "s", 1.0, False),
    "r_c_projection": Column("R_c (projection)", "%", 100.0, False),
    "com_4_13": Column("COM (jerk 4.13)", "%", 100.0, False),
    "com_nuplan_savgol": Column("COM (nuPlan, smoothed)", "%", 100.0, False),
}
"""Metrics in the order of the table. Higher is better for all."""


def column_of(name: str) -> Column:
    """How a metric is shown; a user's own metric as it is, under its name."""
    return COLUMNS.get(name) or Column(name.replace("_", " "), "", 1.0, True)


def columns_of(scored: Iterable[Scored]) -> dict[str, Column]:
    """`COLUMNS`, and one for each own metric of these rollouts."""
    own = dict.fromkeys(name for one in scored for name in one.values if name not in COLUMNS)
    return {**COLUMNS, **{name: column_of(name) for name in own}}


def headlines(names: Iterable[str]) -> list[dict[str, Column]]:
    """Columns of the short tables, by name: recast's, and then own metrics if there are any.

    Both in one table would be wider than a terminal.
    """
    columns = {name: column_of(name) for name in names}
    ours = {name: one for name, one in columns.items() if name in COLUMNS and one.headline}
    own = {name: one for name, one in columns.items() if name not in COLUMNS}
    return [ours, own] if own else [ours]


class Attempt(Protocol):
    """A rollout, failed or not: `RolloutFailure`, and whatever is `Scored`."""

    @property
    def planner(self) -> str:
        """Its name."""

    @property
    def arm(self) -> str:
        """What rendered it."""

    @property
    def track_id(self) -> str | None:
        """The controlled actor."""

    @property
    def motion(self) -> str:
        """What it did."""

    @property
    def setting(self) -> str:
        """How."""


class Scored(Attempt, Protocol):
    """What a rollout scored: `RolloutMetrics`, or a row of a grid; see there."""

    @property
    def steps_run(self) -> int | None:
        """Executed steps; None where the rollout failed."""

    @property
    def plans(self) -> int:
        """How many plans were made."""

    @property
    def cut_reason(self) -> str | None:
        """Why it is shorter than asked."""

    @property
    def values(self) -> Mapping[str, Metric]:
        """Metrics, keys of `COLUMNS` and names of own metrics."""

    def over(self, steps: int) -> Self:
        """The same rollout, ended after `steps` of its steps."""


@dataclass(frozen=True)
class TableRow:
    """One line: the rollouts of a planner under a rendering arm.

    Attributes:
        rollouts: how many were scored; `failed` more ended in an error, `cut` of the scored ones
            are shorter than asked.
        plans: how many plans the scored ones made.
        means: means by metric, in the column's unit, over the rollouts where the metric is valid;
            None if there is none.
        counts: number of these rollouts, by metric.
    """

    planner: str
    arm: str
    rollouts: int
    failed: int
    cut: int
    plans: int
    means: Mapping[str, float | None]
    counts: Mapping[str, int]

    @property
    def asked(self) -> int:
        """Rollouts that were asked for: those that were scored, and those that failed."""
        return self.rollouts + self.failed

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {"planner": self.planner, "arm": self.arm, "asked": self.asked, **asdict(self)}


def table(metrics: Sequence[Scored], failures: Sequence[Attempt] = ()) -> list[TableRow]:
    """Rows in the order in which each planner and arm first occurs.

    A failed rollout has no metric, so it is in no mean: `TableRow` says how many there are. A cut
    one counts as it is; only pairs (see `recast.metrics.table`) put that right. COM is the mean
    over rollouts of the share of plans that pass; with equally many plans in each (the paper's 32)
    that is the share over all plans.
    """
    keys = dict.fromkeys(
        [(m.planner, m.arm) for m in metrics] + [(f.planner, f.arm) for f in failures]
    )
    return [_row(planner, arm, metrics, failures) for planner, arm in keys]


def _row(
    planner: str, arm: str, metrics: Sequence[Scored], failures: Sequence[Attempt]
) -> TableRow:
    mine = [m for m in metrics if (m.planner, m.arm) == (planner, arm)]
    means: dict[str, float | None] = {}
    counts: dict[str, int] = {}
    for name, column in columns_of(metrics).items():
        found = (m.values.get(name) for m in mine)
        values = [one.value for one in found if one is not None and one.value is not None]
        counts[name] = len(values)
        means[name] = column.scale * float(np.mean(values)) if values else None
    return TableRow(
        planner=planner,
        arm=arm,
        rollouts=len(mine),
        failed=sum((f.planner, f.arm) == (planner, arm) for f in failures),
        cut=sum(m.cut_reason is not None for m in mine),
        plans=sum(m.plans for m in mine),
        means=means,
        counts=counts,
    )


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
        """One metric, a key of `recast.metrics.table.COLUMNS` or an own one of all rollouts."""
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
    times, probability = _multisets(n)
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


@lru_cache(maxsize=1)  # a second for 11 scenes, and every metric of a grid has the same
def _multisets(n: int) -> tuple[NDArray[np.int64], Array]:
    """How often (M, n) each of n scenes is in each multiset of n, and its probability (M,)."""
    multisets = np.array(list(combinations_with_replacement(range(n), n)))
    times = np.stack([(multisets == scene).sum(axis=1) for scene in range(n)], axis=1)
    factorials = np.array([float(factorial(k)) for k in range(n + 1)])
    return times, factorials[n] / factorials[times].prod(axis=1) / float(n) ** n


def _sums_and_counts(scenes: Sequence[ArrayLike]) -> tuple[Array, Array]:
    arrays = [np.atleast_1d(np.asarray(scene, np.float64)) for scene in scenes]
    if not arrays or any(len(a) == 0 for a in arrays):
        raise ValueError(
            "bootstrap: expected at least one scene, with at least one pair in every scene"
        )
    return np.array([a.sum() for a in arrays]), np.array([float(len(a)) for a in arrays])
