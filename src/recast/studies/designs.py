"""Where a search looks next: settings with ranges, and designs that choose points among them.

A design is a function of what was found before, so that a study that was stopped goes on as if it
had not been: proposals are not stored, they come out again. Points (d,) hold a value for each axis.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np
from scipy.optimize import brentq
from scipy.stats import lognorm, norm, qmc

from recast.arrays import Array
from recast.core.errors import InputError

Point = tuple[float, ...]
Results = Sequence[tuple[Point, float | None]]
"""Points with their margins in the order in which they were proposed: below 0 where the objective
fails, None where no margin could be had."""

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_RANGE = re.compile(rf"({_NUMBER}):({_NUMBER})")
_RAREST = 1e-4
"""Share of a distribution within a range below which its quantiles are noise."""
_DIGITS = 6
"""Significant digits of a value: a setting is told, filed and found again by them."""


@dataclass(frozen=True)
class Axis:
    """A setting that a search varies.

    Attributes:
        name: its name in a scenario file, such as "gap".
        low, high: range of its values.
        choices: the values, if only some are asked for; none: all of the range.
        unit: unit of the values.
        occurs: how often values occur within the range, see `parse_occurrence`; "": all alike.
    """

    name: str
    low: float
    high: float
    choices: tuple[float, ...] = ()
    unit: str = ""
    occurs: str = ""

    def value(self, share: float) -> float:
        """The value below which a share of the scenarios lies, within 0 and 1."""
        if self.choices:
            return self.choices[min(int(share * len(self.choices)), len(self.choices) - 1)]
        value = self.low + share * (self.high - self.low)
        if self._occurrence is not None:
            below, within = self._within
            value = float(self._occurrence.ppf(below + share * within))
        return float(f"{min(max(value, self.low), self.high):.{_DIGITS}g}")

    def share(self, value: float) -> float:
        """The share of the scenarios that lie below a value."""
        if self.choices:
            return (self.choices.index(value) + 0.5) / len(self.choices)
        if self._occurrence is not None:
            below, within = self._within
            return (float(self._occurrence.cdf(value)) - below) / within
        return (value - self.low) / (self.high - self.low)

    @property
    def told(self) -> str:
        """Values and unit, such as "2 to 40 m"."""
        values = ", ".join(f"{v:g}" for v in self.choices) or f"{self.low:g} to {self.high:g}"
        return " ".join(filter(None, (values, self.unit, self.occurs and f"({self.occurs})")))

    @cached_property
    def _occurrence(self) -> Any | None:
        return parse_occurrence(self.occurs) if self.occurs else None

    @cached_property
    def _within(self) -> tuple[float, float]:
        """The share of all values that lie below the range, and within."""
        assert self._occurrence is not None
        below, above = map(float, self._occurrence.cdf([self.low, self.high]))
        return below, above - below


def parse_occurrence(text: str) -> Any:
    """A distribution of scipy: "normal:MEAN,DEVIATION" or "lognormal:MEDIAN,SIGMA".

    Raises:
        InputError: it is neither.
    """
    name, _, words = text.partition(":")
    numbers = re.fullmatch(rf"({_NUMBER}),({_NUMBER})", words)
    first, second = (float(numbers[1]), float(numbers[2])) if numbers is not None else (0.0, 0.0)
    if name == "normal" and second > 0:
        return norm(first, second)
    if name == "lognormal" and first > 0 and second > 0:
        return lognorm(second, scale=first)
    mend = "write normal:MEAN,DEVIATION or lognormal:MEDIAN,SIGMA, with a deviation above 0"
    raise InputError("`over`", text, "is no distribution", mend)


def parse_axis(text: str) -> Axis:
    """An axis as the command line names it: "gap=2:40", "gap=2:40~lognormal:12,0.5" where values
    occur unlike often, or "gap=5,10,20" for these values alone.

    Raises:
        InputError: it is none of these, or the range is empty.
    """
    name, equals, values = text.partition("=")
    values, _, occurs = values.partition("~")
    mend = "write SETTING=LOW:HIGH, or SETTING=VALUE,VALUE"
    if not equals or not name:
        raise InputError("`over`", text, "is no setting with a range", mend)
    found = _RANGE.fullmatch(values)
    if found is not None:
        low, high = float(found[1]), float(found[2])
        if not low < high:
            raise InputError("`over`", text, "is an empty range", "give the lower value first")
        axis = Axis(name, low, high, occurs=occurs)
        if occurs and axis._within[1] < _RAREST:
            problem = "hardly has a value within the range"
            raise InputError("`over`", text, problem, "give another range or distribution")
        return axis
    words = values.split(",")
    if occurs or not all(re.fullmatch(_NUMBER, word) for word in words):
        raise InputError("`over`", text, "is no setting with a range", mend)
    choices = tuple(sorted({float(word) for word in words}))
    return Axis(name, choices[0], choices[-1], choices)


@dataclass(frozen=True)
class Design:
    """How points are chosen.

    Attributes:
        name: one of `DESIGNS`.
        axes: settings that are varied.
        trials: number of points; for "bisect" along the one range, for each combination of choices.
        seed: seed of what is random.
    """

    name: str
    axes: tuple[Axis, ...]
    trials: int
    seed: int = 0

    def __post_init__(self) -> None:
        if self.name not in DESIGNS:
            mend = f"choose one of {', '.join(DESIGNS)}"
            raise InputError("`design`", self.name, "is not known", mend)
        if not self.axes:
            raise InputError("`over`", "setting", "none is given", "give one, such as gap=2:40")
        names = [axis.name for axis in self.axes]
        for name in names:
            if names.count(name) > 1:
                raise InputError("`over`", name, "is given twice", "give each setting once")
        ranges = sum(not axis.choices for axis in self.axes)
        if self.name == "bisect" and ranges != 1:
            problem = f"bisects along one range, but {ranges} are given"
            raise InputError("`design`", "bisect", problem, "give the others as values: a=1,2,3")
        if self.name == "boundary" and ranges == 0:
            problem = "seeks along ranges, but none is given"
            raise InputError("`design`", "boundary", problem, "take grid, or give a range: a=1:3")
        if self.trials < DESIGNS[self.name].least:
            least = DESIGNS[self.name].least
            problem = f"{self.trials} are too few for {self.name}"
            raise InputError("`trials`", "number", problem, f"give {least} or more")

    @property
    def total(self) -> int:
        """Number of points in the end."""
        if self.name == "grid":
            return len(self.grid())
        return self.trials * (len(self.rows()) if self.name == "bisect" else 1)

    def proposals(self, results: Results) -> list[Point]:
        """The next points, a batch of them; none when all are done.

        Args:
            results: all results up to now; whole batches.
        """
        count = min(self.total - len(results), self._batch())
        return DESIGNS[self.name].propose(self, results, count) if count > 0 else []

    def _batch(self) -> int:
        return len(self.rows()) if self.name == "bisect" else DESIGNS[self.name].batch

    def point(self, shares: Sequence[float]) -> Point:
        """The values at shares (d,) of the scenarios, see `Axis.value`."""
        return tuple(axis.value(float(s)) for axis, s in zip(self.axes, shares, strict=True))

    def shares(self, points: Sequence[Point]) -> Array:
        """The shares (N, d) at which points lie, see `Axis.share`."""
        found = [[a.share(v) for a, v in zip(self.axes, p, strict=True)] for p in points]
        return np.array(found, np.float64).reshape(-1, len(self.axes))

    def grid(self) -> list[Point]:
        """All choices, and as many equally spaced values of each range as the trials allow."""
        ranges = sum(not axis.choices for axis in self.axes)
        chosen = int(np.prod([len(axis.choices) for axis in self.axes if axis.choices]))
        each = max(2, int((self.trials / chosen) ** (1 / max(ranges, 1)) + 1e-9))
        spaced = np.linspace(0.0, 1.0, each)
        values = [axis.choices or tuple(map(axis.value, spaced)) for axis in self.axes]
        return list(product(*values))

    def rows(self) -> list[Point]:
        """For a bisection: the combinations of choices, with the middle of the range."""
        values = [axis.choices or (axis.value(0.5),) for axis in self.axes]
        return list(product(*values))


def _grid(design: Design, results: Results, count: int) -> list[Point]:
    return design.grid()[len(results) : len(results) + count]


def _sobol(design: Design, results: Results, count: int) -> list[Point]:
    return [design.point(one) for one in sobol_shares(design, len(results), count)]


def sobol_shares(design: Design, first: int, count: int) -> Array:
    """Points (count, d) of a scrambled Sobol sequence in the unit cube, from number `first` on."""
    sequence = qmc.Sobol(len(design.axes), scramble=True, rng=np.random.default_rng(design.seed))
    if first:
        sequence.fast_forward(first)
    # One by one, as scipy warns of counts that are no power of two.
    return np.concatenate([sequence.random(1) for _ in range(count)])


# Bisection


CLIPPED = 4.0
"""Metres (or units of the objective) beyond which a larger margin says nothing more of where the
boundary is."""


class _UnknownError(Exception):
    def __init__(self, value: float) -> None:
        super().__init__()
        self.value = value


def _bisect(design: Design, results: Results, count: int) -> list[Point]:
    """The next point of each combination of choices."""
    along = next(i for i, axis in enumerate(design.axes) if not axis.choices)
    axis, proposed = design.axes[along], []
    for row in design.rows()[:count]:
        others = row[:along] + row[along + 1 :]
        known = {p[along]: m for p, m in results if p[:along] + p[along + 1 :] == others}
        value = next_along(axis, known)
        proposed.append((*row[:along], value, *row[along + 1 :]))
    return proposed


def next_along(axis: Axis, known: Mapping[float, float | None]) -> float:
    """Where to look next along one axis for a change of verdict.

    Both ends first; between them, by Brent's method on the clipped margin, which is as fast as the
    margin is continuous and falls back to halving where it jumps. Where no change is known, in the
    middle of the widest gap.
    """
    for end in (axis.value(0.0), axis.value(1.0)):
        if end not in known:
            return end
    verdicts = {value: margin for value, margin in sorted(known.items()) if margin is not None}
    change = next(
        ((a, b) for a, b in pairwise(verdicts) if (verdicts[a] < 0) != (verdicts[b] < 0)), None
    )
    low, high = change or max(pairwise(sorted(known)), key=lambda gap: gap[1] - gap[0])
    middle = axis.value(axis.share((low + high) / 2))
    slow = high - low > (axis.high - axis.low) * 2.0 ** (_HALVINGS_LOST + 2 - len(known))
    value = middle if change is None or slow else _brent(axis, known, change)
    if value in known:  # as fine as values are told
        low, high = max(pairwise(sorted(known)), key=lambda gap: gap[1] - gap[0])
        return axis.value(axis.share((low + high) / 2))
    return value


_HALVINGS_LOST = 2
"""Steps by which Brent's method may be behind halving before it is given up."""


def _brent(axis: Axis, known: Mapping[float, float | None], change: tuple[float, float]) -> float:
    """The point that Brent's method asks for next, where the verdict changes within `change`."""

    def margin(value: float) -> float:
        value = axis.value(axis.share(value))
        if value not in known:
            raise _UnknownError(value)
        found = known[value]
        # A failed trial is no verdict: it stays undecided on the side of those that pass.
        return CLIPPED if found is None else float(np.clip(found, -CLIPPED, CLIPPED)) or 1e-9

    ends = axis.value(0.0), axis.value(1.0)
    if (margin(ends[0]) < 0) == (margin(ends[1]) < 0):
        ends = change
    try:
        brentq(margin, *ends, xtol=(axis.high - axis.low) * 10.0 ** (1 - _DIGITS), rtol=1e-12)
    except _UnknownError as unknown:
        return unknown.value
    return axis.value(axis.share(sum(change) / 2))


# A Gaussian process that seeks the boundary


def _boundary(design: Design, results: Results, count: int) -> list[Point]:
    """A Sobol sequence first, then where the boundary is least certain."""
    begin = _begin(design)
    if len(results) < begin:
        return _sobol(design, results, min(count, begin - len(results)))
    if all(margin is None for _, margin in results):
        return _sobol(design, results, count)
    field = MarginField.fit(design, results)
    pool = _candidates(design, results, begin)
    chosen: list[Point] = []
    for _ in range(min(count, len(pool))):
        mean, deviation = field.at(pool)
        best = int(np.argmax(_STRADDLE * deviation - np.abs(mean)))
        chosen.append(design.point(pool[best]))
        # The next of the batch sees this one as if it had come out as expected.
        field = field.believing(pool[best], float(mean[best]))
        pool = np.delete(pool, best, axis=0)
    return chosen or _sobol(design, results, count)


def _candidates(design: Design, results: Results, begin: int) -> Array:
    """Shares (N, d) of points that were not tried yet, and whose nearest neighbour among the tried
    ones has a verdict: where scenarios are refused or planners fail nothing can be learned."""
    tried = {point for point, _ in results}
    sequence = sobol_shares(design, begin, _CANDIDATES)
    # Some lie on the border: a boundary in a corner shows nowhere else.
    sequence = np.clip(0.5 + _OVER_THE_BORDER * (sequence - 0.5), 0.0, 1.0)
    points = dict.fromkeys(design.point(one) for one in sequence)
    pool = design.shares([point for point in points if point not in tried])
    known = design.shares([point for point, _ in results])
    nearest = np.argmin(((pool[:, None] - known[None]) ** 2).sum(axis=-1), axis=1)
    told = np.array([margin is not None for _, margin in results])[nearest]
    return pool[told] if told.any() else pool


_CANDIDATES, _OVER_THE_BORDER = 1024, 1.08
_STRADDLE = 1.96
"""Deviations by which a point may be off that still counts as near the boundary: the straddle
heuristic (Bryan et al., "Active learning for identifying function threshold boundaries", 2005)."""


def _begin(design: Design) -> int:
    return min(design.trials, 4 + 6 * len(design.axes))


_FITTED = 400


def telling(measured: Sequence[tuple[Point, float]], most: int) -> Sequence[tuple[Point, float]]:
    """At most so many of the results: half of them those nearest to the boundary, the others spread
    over the rest; in their order."""
    if len(measured) <= most:
        return measured
    order = np.argsort([abs(margin) for _, margin in measured], kind="stable")
    near, rest = order[: most // 2], np.sort(order[most // 2 :])
    spread = rest[np.linspace(0, len(rest) - 1, most - len(near)).astype(int)]
    return [measured[i] for i in np.sort(np.concatenate([near, spread]))]


@dataclass(frozen=True)
class MarginField:
    """The clipped margin over the unit cube by a Gaussian process.

    Attributes:
        shares: (N, d) where it was measured.
        margins: (N,) what was measured, clipped and in units of `CLIPPED`.
        process: the fitted process.
    """

    shares: Array
    margins: Array
    process: Any

    @classmethod
    def fit(cls, design: Design, results: Results) -> MarginField:
        """Fit length scales to results; those without a margin count for nothing.

        Of very many, to `telling` ones: a process takes the cube of their number.
        """
        from sklearn.gaussian_process import GaussianProcessRegressor  # takes a second to import
        from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

        measured = telling([(p, margin) for p, margin in results if margin is not None], _FITTED)
        shares = design.shares([point for point, _ in measured])
        margins = np.clip([margin for _, margin in measured], -CLIPPED, CLIPPED) / CLIPPED
        scales = np.full(len(design.axes), 0.3)
        kernel = ConstantKernel(1.0, (0.1, 10.0)) * Matern(scales, (0.05, 5.0), nu=2.5)
        kernel += WhiteKernel(1e-3, (1e-5, 0.1))
        process = GaussianProcessRegressor(kernel, random_state=design.seed, n_restarts_optimizer=2)
        with catch_warnings():
            simplefilter("ignore")  # a scale at its bound is as good: the region is finite
            return cls(shares, margins, process.fit(shares, margins))

    def believing(self, share: Array, margin: float) -> MarginField:
        """The field with one more measurement, length scales as they are."""
        from sklearn.gaussian_process import GaussianProcessRegressor

        kernel = self.process.kernel_
        shares = np.concatenate([self.shares, share[None]])
        margins = np.append(self.margins, margin)
        process = GaussianProcessRegressor(kernel, optimizer=None).fit(shares, margins)
        return MarginField(shares, margins, process)

    def at(self, shares: Array) -> tuple[Array, Array]:
        """Mean and standard deviation (M,) at shares (M, d), in units of `CLIPPED`."""
        mean, deviation = self.process.predict(shares, return_std=True)
        return mean, deviation

    def draws(self, shares: Array, count: int, seed: int) -> Array:
        """Draws (M, count) of the process at shares (M, d)."""
        found: Array = self.process.sample_y(shares, count, random_state=seed)
        return found


@dataclass(frozen=True)
class _Kind:
    propose: Callable[[Design, Results, int], list[Point]]
    least: int
    batch: int


DESIGNS: Mapping[str, _Kind] = {
    "boundary": _Kind(_boundary, 12, 4),
    "bisect": _Kind(_bisect, 3, 1),
    "grid": _Kind(_grid, 1, 64),
    "sobol": _Kind(_sobol, 1, 64),
}
"""By name: a Gaussian process that seeks where the verdict changes; halving along one range;
equally spaced values; a Sobol sequence."""
