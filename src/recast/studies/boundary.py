"""What a search found: where a planner begins to fail, how sure that is, and how far one arm's
boundary lies from the truth's."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest, norm, qmc

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.table_files import read_parquet
from recast.metrics.table import Bootstrap, cluster_bootstrap
from recast.runs.arms import truth_of
from recast.studies.designs import CLIPPED, Axis, Design, MarginField, Point
from recast.studies.search import SearchResults
from recast.studies.study_database import SearchLine, Trial

ROWS = 9
"""Places along the second setting at which the boundary along the first is told."""
_FINE = 801
_LEVEL = 0.95
_Z = float(norm.ppf((1 + _LEVEL) / 2))
_DRAWS = 200
_SHARE_POINTS = 512
"""Points of the region, and draws of the process, for the share that fails and its interval."""
_LEAST = 6
"""Trials with a verdict below which nothing is said of a region."""


@dataclass(frozen=True)
class Crossing:
    """A place where the verdict changes along the first range.

    Attributes:
        others: values of the other axes, in their order.
        value: value of the first range there.
        low, high: interval of 95 % of it; of a bisection, what brackets it.
        fails_below: whether it fails below the value, rather than above.
    """

    others: Point
    value: float
    low: float
    high: float
    fails_below: bool


@dataclass(frozen=True)
class LineAnswer:
    """What was found on one line.

    Attributes:
        trials: those with a verdict that count; `unfair` more that no driver could have mastered,
            `refused` that are impossible, `failed` without a verdict for another reason.
        fails: how many of `trials` fail.
        share: share of the scenarios that fail and its interval of 95 %; None for a bisection, and
            where nothing can be said. All of the region counts alike, or as often as the axes say.
        crossings: the boundary, row by row.
        mildest: the failure that asks least of a driver; None without any.
        hardest: the success that asks most; None without any.
        field: margin over the region; None for a bisection, and with few trials.
    """

    line: SearchLine
    trials: tuple[Trial, ...]
    unfair: tuple[Trial, ...]
    refused: tuple[Trial, ...]
    failed: tuple[Trial, ...]
    fails: int
    share: tuple[float, float, float] | None
    crossings: tuple[Crossing, ...]
    mildest: Trial | None
    hardest: Trial | None
    field: MarginField | None


@dataclass(frozen=True)
class BoundaryDistance:
    """How far an arm's boundary lies from the truth's, along the first range.

    Attributes:
        arm, planner, motion: whose; `scenes` logs were compared.
        rows: rows in which both have one crossing.
        distance, shift: mean of the absolute, and of the signed, difference.
        differs: share of the region where the verdicts differ; None for bisections.
        beside: uncertainty of a row's difference from both boundaries' intervals, mean.
    """

    arm: str
    planner: str
    motion: str
    scenes: int
    rows: int
    distance: Bootstrap
    shift: Bootstrap
    differs: float | None
    beside: float


@dataclass(frozen=True)
class SearchAnswers:
    """All that a search found."""

    results: SearchResults
    lines: tuple[LineAnswer, ...]
    distances: tuple[BoundaryDistance, ...]


def answers_of(results: SearchResults, fair_only: bool = True) -> SearchAnswers:
    """What all trials of a study say.

    Args:
        fair_only: leave out scenarios that no driver could have mastered.
    """
    design = results.settings.design
    lines = tuple(_answer(line, one, design, fair_only) for line, one in results.lines.items())
    return SearchAnswers(results, lines, tuple(_distances(results, lines)))


def along(axes: Sequence[Axis]) -> int:
    """Number of the axis along which the boundary is told: the first range."""
    return next((i for i, axis in enumerate(axes) if not axis.choices), 0)


def is_fair(trial: Trial) -> bool:
    """Whether a driver could have mastered the scenario of a trial that has a verdict."""
    return bool((trial.result or {}).get("driver", {}).get("fair", True))


def _answer(
    line: SearchLine, trials: Sequence[Trial], design: Design, fair_only: bool
) -> LineAnswer:
    told = [one for one in trials if one.margin is not None]
    missing = [one for one in trials if one.result is not None and one.margin is None]
    kinds = [bool((one.result or {}).get("refused")) for one in missing]
    refused = tuple(one for one, kind in zip(missing, kinds, strict=True) if kind)
    unfair = tuple(one for one in told if fair_only and not is_fair(one))
    counted = tuple(one for one in told if not fair_only or is_fair(one))
    fails = [one for one in counted if _fails(one)]
    passes = [one for one in counted if not _fails(one)]
    field = None
    both = {_fails(one) for one in told}
    if design.name != "bisect" and len(told) >= _LEAST and len(both) == 2:
        field = MarginField.fit(design, [(one.point, one.margin) for one in told])
    if design.name == "bisect":
        crossings = tuple(_bracketed(told, design))
    else:
        crossings = () if field is None else tuple(_crossings(field, design))
    return LineAnswer(
        line,
        counted,
        unfair,
        refused,
        tuple(one for one, kind in zip(missing, kinds, strict=True) if not kind),
        len(fails),
        _share(design, counted, unfair, field, len(fails)),
        crossings,
        min(fails, key=lambda one: (_asked(one), -(one.margin or 0.0)), default=None),
        max(passes, key=lambda one: (_asked(one), -(one.margin or 0.0)), default=None),
        field,
    )


def _fails(trial: Trial) -> bool:
    return trial.margin is not None and trial.margin < 0


def _asked(trial: Trial) -> float:
    """Deceleration that a trial's scenario asks of a driver."""
    needed = (trial.result or {}).get("driver", {}).get("braking")
    return np.inf if needed is None else float(needed)


def _rows(design: Design) -> list[Point]:
    """Values of the other axes at which the boundary is told."""
    first = along(design.axes)
    others = [axis for i, axis in enumerate(design.axes) if i != first]
    ranges = sum(not axis.choices for axis in others)
    if ranges <= 1:
        spaced = np.linspace(0.0, 1.0, ROWS)
        return list(product(*(a.choices or tuple(map(a.value, spaced)) for a in others)))
    shares = qmc.Sobol(len(others), scramble=False).random(32)
    return [tuple(a.value(float(s)) for a, s in zip(others, one, strict=True)) for one in shares]


def _with(others: Point, value: float, first: int) -> Point:
    return (*others[:first], value, *others[first:])


def _crossings(field: MarginField, design: Design) -> Iterable[Crossing]:
    first = along(design.axes)
    axis = design.axes[first]
    spaced = np.linspace(0.0, 1.0, _FINE)
    values = [axis.value(float(share)) for share in spaced]
    for others in _rows(design):
        row = design.shares([_with(others, axis.low, first)])[0]
        shares = np.tile(row, (_FINE, 1))
        shares[:, first] = spaced
        mean, deviation = field.at(shares)
        sure = np.abs(mean) > _Z * deviation
        for i in np.flatnonzero((mean[:-1] < 0) != (mean[1:] < 0)):
            part = mean[i] / (mean[i] - mean[i + 1])
            below, above = np.flatnonzero(sure[: i + 1]), np.flatnonzero(sure[i + 1 :])
            yield Crossing(
                others,
                float(values[i] + part * (values[i + 1] - values[i])),
                values[below[-1]] if len(below) else axis.low,
                values[i + 1 + above[0]] if len(above) else axis.high,
                bool(mean[i] < 0),
            )


def contour(field: MarginField, design: Design, first: int, second: int) -> list[Array]:
    """Pieces (2, 2) of the boundary in the plane of two axes, in their values; others in the
    middle. A piece for each cell of a grid that it crosses (marching squares)."""
    spaced = np.linspace(0.0, 1.0, _CELLS + 1)
    shares = np.full((len(spaced), len(spaced), len(design.axes)), 0.5)
    shares[..., first], shares[..., second] = np.meshgrid(spaced, spaced, indexing="ij")
    mean = field.at(shares.reshape(-1, len(design.axes)))[0].reshape(len(spaced), -1)
    places = shares[..., [first, second]]
    named = design.axes[first], design.axes[second]
    pieces = []
    for i, j in product(range(_CELLS), repeat=2):
        corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
        found = []
        for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
            if (mean[a] < 0) != (mean[b] < 0):
                part = mean[a] / (mean[a] - mean[b])
                found.append(places[a] + part * (places[b] - places[a]))
        values = [[a.value(float(s)) for a, s in zip(named, at, strict=True)] for at in found]
        pieces += [np.array(values[k : k + 2]) for k in range(0, len(values), 2)]
    return pieces


_CELLS = 48


def _bracketed(told: Sequence[Trial], design: Design) -> Iterable[Crossing]:
    first = along(design.axes)
    by_row: dict[Point, list[tuple[float, float]]] = {}
    for one in told:
        others = one.point[:first] + one.point[first + 1 :]
        by_row.setdefault(others, []).append((one.point[first], one.margin or 0.0))
    for others, found in sorted(by_row.items()):
        for (a, at_a), (b, at_b) in pairwise(sorted(found)):
            if (at_a < 0) == (at_b < 0):
                continue
            left, right = (float(np.clip(m, -CLIPPED, CLIPPED)) for m in (at_a, at_b))
            value = a + (b - a) * (left / (left - right) if left != right else 0.5)
            yield Crossing(others, value, a, b, at_a < 0)


def _share(
    design: Design,
    counted: Sequence[Trial],
    unfair: Sequence[Trial],
    field: MarginField | None,
    fails: int,
) -> tuple[float, float, float] | None:
    """The share of the region that fails: counted where trials are spread evenly, else by the
    process, over the points whose nearest trial is fair."""
    if design.name == "bisect" or len(counted) < _LEAST:
        return None
    if design.name != "boundary" or field is None:
        found = binomtest(fails, len(counted)).proportion_ci(_LEVEL, "wilson")
        return fails / len(counted), float(found.low), float(found.high)
    shares = qmc.Sobol(len(design.axes), scramble=False).random(_SHARE_POINTS)
    if unfair:
        told = design.shares([one.point for one in (*counted, *unfair)])
        nearest = np.argmin(((shares[:, None] - told[None]) ** 2).sum(axis=-1), axis=1)
        shares = shares[nearest < len(counted)]
    if len(shares) == 0:
        return None
    mean, deviation = field.at(shares)
    draws = field.draws(shares, _DRAWS, design.seed)
    low, high = np.quantile((draws < 0).mean(axis=0), [(1 - _LEVEL) / 2, (1 + _LEVEL) / 2])
    return float(norm.cdf(-mean / np.maximum(deviation, 1e-9)).mean()), float(low), float(high)


def _distances(results: SearchResults, lines: Sequence[LineAnswer]) -> Iterable[BoundaryDistance]:
    run, design = results.settings.bench.run, results.settings.design
    truth = truth_of(run.arms)
    found = {one.line: one for one in lines}
    for motion, planner, arm in product(run.motions, run.planners, run.arms):
        if truth is None or arm.name == truth:
            continue
        differences: list[Array] = []
        beside: list[float] = []
        differs: list[float] = []
        for scene in dict.fromkeys(line.scene for line in found):
            one = found[SearchLine(scene, motion, planner, arm.name)]
            true = found[SearchLine(scene, motion, planner, truth)]
            pairs = list(_paired(one.crossings, true.crossings))
            if pairs:
                differences.append(np.array([a.value - b.value for a, b in pairs]))
                beside += [np.hypot(a.high - a.low, b.high - b.low) / 2 for a, b in pairs]
            if one.field is not None and true.field is not None:
                shares = qmc.Sobol(len(design.axes), scramble=False).random(_SHARE_POINTS)
                verdicts = [each.field.at(shares)[0] < 0 for each in (one, true) if each.field]
                differs.append(float((verdicts[0] != verdicts[1]).mean()))
        if not differences:
            continue
        drawn = [np.random.default_rng(results.settings.design.seed) for _ in range(2)]
        yield BoundaryDistance(
            arm.name,
            planner,
            motion,
            len(differences),
            sum(map(len, differences)),
            cluster_bootstrap([np.abs(one) for one in differences], drawn[0], 10_000),
            cluster_bootstrap(differences, drawn[1], 10_000),
            float(np.mean(differs)) if differs else None,
            float(np.mean(beside)),
        )


def _paired(
    one: Sequence[Crossing], other: Sequence[Crossing]
) -> Iterable[tuple[Crossing, Crossing]]:
    """Crossings of the rows in which both have exactly one, in the same direction."""
    rows, true = _by_row(one), _by_row(other)
    for others in rows:
        a, b = rows[others], true.get(others, [])
        if len(a) == len(b) == 1 and a[0].fails_below == b[0].fails_below:
            yield a[0], b[0]


def _by_row(found: Sequence[Crossing]) -> dict[Point, list[Crossing]]:
    rows: dict[Point, list[Crossing]] = {}
    for one in found:
        rows.setdefault(one.others, []).append(one)
    return rows


@dataclass(frozen=True)
class StudyComparison:
    """A study against an earlier one, at the points that both have tried.

    Attributes:
        common: number of those with a verdict in both.
        new: trials that fail now and did not, with their lines.
        gone: trials that failed and do not now.
    """

    common: int
    new: tuple[tuple[SearchLine, Trial], ...]
    gone: tuple[tuple[SearchLine, Trial], ...]


def compare(found: SearchAnswers, earlier: Path) -> StudyComparison:
    """Compare with an earlier study: of another version of a planner, or of another planner if both
    studies have one each. Scenarios that no driver could have mastered are left out as in `found`.

    Raises:
        InputError: the folder has no finished study, or none of the same logs, motions, arms and
            points.
    """
    axes = [axis.name for axis in found.results.settings.design.axes]
    names = [*_LINE, *axes, "margin"]
    path = earlier / TRIALS_FILE
    if not path.is_file():
        raise InputError(path, "trials", "are missing", "give the folder of a finished search")
    table = read_parquet(path, names, "give the folder of a finished search of these settings").data
    rows = list(zip(*(table[name].to_pylist() for name in names), strict=True))
    planners = {row[2] for row in rows}
    known = {(*row[:2], row[3], *row[4:-1], row[2]): row[-1] for row in rows}
    common, new, gone = 0, [], []
    single = len({one.line.planner for one in found.lines}) == len(planners) == 1
    for one in found.lines:
        planner = next(iter(planners)) if single else one.line.planner
        place = (one.line.scene, one.line.motion, one.line.arm)
        for trial in one.trials:
            before = known.get((*place, *trial.point, planner))
            if before is None:
                continue
            common += 1
            if _fails(trial) and before >= 0:
                new.append((one.line, trial))
            elif not _fails(trial) and before < 0:
                gone.append((one.line, trial))
    if common == 0:
        problem = "has none of the logs, motions, arms and points of this study"
        mend = "compare studies of one design and seed; sobol and grid try the same points"
        raise InputError(path, "trials", problem, mend)
    return StudyComparison(common, tuple(new), tuple(gone))


_LINE = ("scene", "motion", "planner", "arm")
TRIALS_FILE = "trials.parquet"


def sentence(answer: LineAnswer, axes: Sequence[Axis]) -> str:
    """What a person would say of a line."""
    first = along(axes)
    axis = axes[first]
    other = [one for i, one in enumerate(axes) if i != first]
    counted = len(answer.trials)
    if not counted:
        return "no trial has a verdict"
    if not answer.crossings:
        if answer.fails in (0, counted):
            return "never fails" if answer.fails == 0 else "always fails"
        return f"fails in {answer.fails} of {counted} trials, without a clear boundary"
    values = [one.value for one in answer.crossings]
    below = sum(one.fails_below for one in answer.crossings) * 2 >= len(answer.crossings)
    span = f"{min(values):.3g}" if len(values) == 1 else f"{min(values):.3g} to {max(values):.3g}"
    words = f"fails {'below' if below else 'above'} {axis.name} {span} {axis.unit}".rstrip()
    if len(values) > 1 and len(other) == 1:
        worst, best = (
            pick(answer.crossings, key=lambda one: one.value).others[0] for pick in (min, max)
        )
        words += f" ({other[0].name} {worst:.3g} to {best:.3g} {other[0].unit})".replace(" )", ")")
    return words


def counted_words(answer: LineAnswer) -> str:
    """How many trials there are, of what kind."""
    words = [f"{len(answer.trials)} trials, {answer.fails} fail"]
    for trials, kind in (
        (answer.unfair, "beyond any driver"),
        (answer.refused, "impossible"),
        (answer.failed, "without a verdict"),
    ):
        if trials:
            words.append(f"{len(trials)} {kind}")
    return ", ".join(words)


def search_rows(found: SearchAnswers) -> dict[str, list[dict[str, Any]]]:
    """Plain rows by table."""
    axes = found.results.settings.design.axes
    names = [axis.name for axis in axes]
    first = along(axes)
    others = [name for i, name in enumerate(names) if i != first]
    return {
        "lines": [
            {
                **vars(one.line),
                "found": sentence(one, axes),
                "trials": len(one.trials),
                "fails": one.fails,
                "beyond_any_driver": len(one.unfair),
                "impossible": len(one.refused),
                "failed": len(one.failed),
                "share": None if one.share is None else one.share[0],
                "share_low": None if one.share is None else one.share[1],
                "share_high": None if one.share is None else one.share[2],
            }
            for one in found.lines
        ],
        "boundary": [
            {
                **vars(one.line),
                **dict(zip(others, crossing.others, strict=True)),
                names[first]: crossing.value,
                "low": crossing.low,
                "high": crossing.high,
                "fails": "below" if crossing.fails_below else "above",
            }
            for one in found.lines
            for crossing in one.crossings
        ],
        "distances": [
            {
                "planner": one.planner,
                "motion": one.motion,
                "arm": one.arm,
                "logs": one.scenes,
                "rows": one.rows,
                "distance": one.distance.point,
                "distance_low": one.distance.low,
                "distance_high": one.distance.high,
                "shift": one.shift.point,
                "shift_low": one.shift.low,
                "shift_high": one.shift.high,
                "differs": one.differs,
            }
            for one in found.distances
        ],
    }
