"""Where a search looks next: the same for the same results, and soon at the boundary."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from recast.core.errors import InputError
from recast.studies.boundary import contour
from recast.studies.designs import (
    Axis,
    Design,
    MarginField,
    Point,
    next_along,
    parse_axis,
    telling,
)

GAP, SPEED = parse_axis("gap=2:40"), parse_axis("speed=0.3:1.2")


def margin(point: Point) -> float:
    """Fails below a curve; a contact leaps no further than it is from the boundary."""
    gap, speed = point
    return 0.8 * (gap - (12.0 - 7.0 * speed + 3.0 * np.sin(4 * speed)))


def run(design: Design, of: object = margin) -> list[tuple[Point, float | None]]:
    results: list[tuple[Point, float | None]] = []
    while points := design.proposals(results):
        results += [(point, of(point)) for point in points]  # type: ignore[operator]
    return results


def test_an_axis_is_a_range_or_values() -> None:
    assert Axis("gap", 2.0, 40.0) == GAP
    assert parse_axis("delay=3,0,1.5").choices == (0.0, 1.5, 3.0)
    assert parse_axis("lateral=-3:3").value(0.5) == 0.0
    assert GAP.value(1 / 3) == 14.6667  # as it is told and filed
    for share in (0.0, 0.37, 1.0):
        assert GAP.share(GAP.value(share)) == pytest.approx(share, abs=1e-5)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("gap", "no setting with a range"),
        ("=2:40", "no setting with a range"),
        ("gap=near", "no setting with a range"),
        ("gap=2:40:60", "no setting with a range"),
        ("gap=1,,2", "no setting with a range"),
        ("gap=40:2", "an empty range"),
        ("gap=2:2", "an empty range"),
        ("gap=2:40~uniform:1,2", "no distribution"),
        ("gap=2:40~normal:15", "no distribution"),
        ("gap=2:40~normal:15,0", "no distribution"),
        ("gap=2:40~lognormal:-15,1", "no distribution"),
        ("gap=2:40~normal:500,1", "hardly has a value within the range"),
        ("gap=2,40~normal:15,6", "no setting with a range"),
    ],
)
def test_a_wrong_axis_is_refused(text: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        parse_axis(text)


@given(share=st.floats(0.0, 1.0), occurs=st.sampled_from(["normal:15,6", "lognormal:9,0.7"]))
def test_values_occur_as_often_as_is_said(share: float, occurs: str) -> None:
    axis = parse_axis(f"gap=2:40~{occurs}")
    value = axis.value(share)
    assert 2.0 <= value <= 40.0
    # A value is told by six digits, so its share is known to a density's worth of 1e-4 m.
    assert axis.share(value) == pytest.approx(share, abs=2e-5)


def test_the_share_that_fails_is_of_the_scenarios_as_they_occur() -> None:
    axis = parse_axis("gap=2:40~normal:15,6")
    points = [p for p, _ in run(Design("sobol", (axis,), 256), lambda point: point[0] - 9.0)]
    expected = (norm.cdf(-1) - norm.cdf(-13 / 6)) / (norm.cdf(25 / 6) - norm.cdf(-13 / 6))
    assert np.mean([p[0] < 9.0 for p in points]) == pytest.approx(expected, abs=1 / 256 + 1e-9)


@pytest.mark.parametrize(
    ("name", "axes", "trials", "problem"),
    [
        ("annealing", (GAP,), 20, "is not known"),
        ("grid", (), 20, "none is given"),
        ("grid", (GAP, GAP), 20, "is given twice"),
        ("bisect", (GAP, SPEED), 20, "bisects along one range, but 2"),
        ("boundary", (parse_axis("delay=1,2"),), 20, "none is given"),
        ("boundary", (GAP,), 3, "3 are too few for boundary"),
        ("sobol", (GAP,), 0, "0 are too few"),
    ],
)
def test_a_wrong_design_is_refused(
    name: str, axes: tuple[Axis, ...], trials: int, problem: str
) -> None:
    with pytest.raises(InputError, match=problem):
        Design(name, axes, trials)


def test_a_grid_has_all_values_and_its_ends() -> None:
    design = Design("grid", (GAP, parse_axis("delay=0,1")), 40)
    points = [point for point, _ in run(design)]
    assert len(points) == design.total == 40 and len(set(points)) == 40
    assert {gap for gap, _ in points} >= {2.0, 40.0}
    assert {delay for _, delay in points} == {0.0, 1.0}


def test_sobol_goes_on_where_it_was() -> None:
    design = Design("sobol", (GAP, SPEED), 300, seed=3)
    points = [point for point, _ in run(design)]
    assert len(set(points)) == 300
    first = Design("sobol", (GAP, SPEED), 100, seed=3)
    assert [point for point, _ in run(first)] == points[:100]
    assert [p for p, _ in run(Design("sobol", (GAP, SPEED), 100, seed=4))] != points[:100]


@given(
    boundary=st.floats(2.5, 39.5),
    below=st.floats(0.1, 30.0),
    above=st.floats(0.1, 30.0),
    fails_below=st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_a_bisection_closes_in_on_any_leap(
    boundary: float, below: float, above: float, fails_below: bool
) -> None:
    """Margins that say nothing but the side: three steps slower than halving, at most."""
    known: dict[float, float | None] = {}
    while len(known) < 12:
        value = next_along(GAP, known)
        assert GAP.low <= value <= GAP.high
        assert value not in known
        known[value] = -below if (value < boundary) == fails_below else above
    low = max((v for v in known if v < boundary), default=GAP.low)
    high = min((v for v in known if v >= boundary), default=GAP.high)
    assert high - low <= (GAP.high - GAP.low) * 2.0 ** (3 - 10) + 1e-4


@given(boundary=st.floats(2.5, 39.5), slope=st.floats(0.2, 3.0), braking=st.floats(2.0, 8.0))
@settings(max_examples=60, deadline=None)
def test_a_bisection_of_eight_finds_a_continuous_boundary(
    boundary: float, slope: float, braking: float
) -> None:
    """Distance left on the one side, braking that lacked on the other, as margins are."""
    known: dict[float, float | None] = {}
    while len(known) < 8:
        value = next_along(GAP, known)
        apart = value - boundary
        known[value] = slope * apart if apart >= 0 else braking / 6 * apart
    low = max((v for v in known if v < boundary), default=GAP.low)
    high = min((v for v in known if v >= boundary), default=GAP.high)
    at_low, at_high = (float(np.clip(known[v] or 0.0, -4, 4)) for v in (low, high))
    between = low + (high - low) * at_low / (at_low - at_high)
    assert abs(between - boundary) < 0.25


def test_a_bisection_looks_for_a_change_where_its_ends_agree() -> None:
    """An island: fails between 20 and 24 alone."""
    known: dict[float, float | None] = {}
    while len(known) < 20:
        value = next_along(GAP, known)
        known[value] = -1.0 if 20 < value < 24 else 1.0
    assert any(margin is not None and margin < 0 for margin in known.values())
    sides = [v for v, m in sorted(known.items()) if m is not None and m < 0]
    assert min(abs(sides[0] - 20), abs(sides[-1] - 24)) < 1.0


def test_a_bisection_goes_around_a_failed_trial() -> None:
    known: dict[float, float | None] = {}
    while len(known) < 12:
        value = next_along(GAP, known)
        assert value not in known
        known[value] = None if len(known) == 3 else value - 11.0
    assert min(abs(value - 11.0) for value in known) < 0.2


def test_each_combination_of_values_has_its_own_bisection() -> None:
    design = Design("bisect", (GAP, parse_axis("speed=0.4,0.8")), 8)
    results = run(design)
    assert len(results) == design.total == 16
    for speed in (0.4, 0.8):
        true = 12.0 - 7.0 * speed + 3.0 * np.sin(4 * speed)
        tried = [point[0] for point, _ in results if point[1] == speed]
        assert len(set(tried)) == 8 and min(abs(gap - true) for gap in tried) < 0.05


@pytest.mark.parametrize("seed", [0, 1])
def test_the_boundary_is_found_where_a_sobol_sequence_does_not_see_it(seed: int) -> None:
    speeds = np.linspace(0.3, 1.2, 10)
    true = 12.0 - 7.0 * speeds + 3.0 * np.sin(4 * speeds)
    errors = {}
    for name in ("boundary", "sobol"):
        design = Design(name, (GAP, SPEED), 60, seed)
        field = MarginField.fit(design, run(design))
        fine = np.linspace(0.0, 1.0, 2001)
        found = []
        for speed in speeds:
            shares = np.stack([fine, np.full_like(fine, SPEED.share(float(speed)))], axis=1)
            mean, _ = field.at(shares)
            found.append(GAP.value(float(fine[int(np.argmax(mean >= 0))])))
        errors[name] = np.abs(np.array(found) - true).mean()
    assert errors["boundary"] < 0.3
    assert errors["boundary"] < errors["sobol"]


def test_a_study_that_was_stopped_goes_on_with_the_same_points() -> None:
    design = Design("boundary", (GAP, SPEED), 24, seed=2)
    results = run(design)
    for done in (0, 16, 20):
        again = design.proposals(results[:done])
        assert again == [point for point, _ in results[done : done + len(again)]]


def test_trials_without_a_verdict_do_not_stop_the_search() -> None:
    design = Design("boundary", (GAP, SPEED), 28, seed=2)
    results = run(design, lambda point: None if point[0] < 6 else margin(point))
    assert len(results) == 28
    results = run(design, lambda point: None)  # all fail: evenly spread to the end
    assert len({point for point, _ in results}) == 28
    assert len(run(design, lambda point: 5.0)) == 28  # nothing ever fails


def test_no_point_is_tried_twice_and_few_where_nothing_can_be_learned() -> None:
    """A third of the region is refused, say because it lies off the road."""
    design = Design("boundary", (GAP, SPEED), 60, seed=1)
    results = run(design, lambda point: None if point[1] < 0.6 else margin(point))
    assert len({point for point, _ in results}) == 60
    refused = sum(found is None for _, found in results)
    assert refused < 20
    field = MarginField.fit(design, results)
    for speed in (0.7, 0.9, 1.1):
        true = 12.0 - 7.0 * speed + 3.0 * np.sin(4 * speed)
        [mean], _ = field.at(design.shares([(true, speed)]))
        assert abs(mean) < 0.15


def test_of_very_many_results_those_at_the_boundary_tell() -> None:
    many = [((float(i),), i - 5000.0) for i in range(10_000)]
    some = telling(many, 400)
    assert len(some) == 400 == len(set(some))
    assert sum(abs(margin) <= 100 for _, margin in some) >= 200
    assert some[0][0] == (0.0,) and some[-1][0] == (9999.0,)
    assert telling(many[:300], 400) == many[:300]


def test_the_contour_is_where_the_margin_is_zero() -> None:
    """A disc of failures in the plane, and a third setting that matters nothing."""
    axes = (GAP, SPEED, parse_axis("delay=0:1"))
    design = Design("sobol", axes, 200)
    results = run(design, lambda p: np.hypot((p[0] - 20) / 10, (p[1] - 0.75) / 0.3) - 1)
    pieces = np.stack(contour(MarginField.fit(design, results), design, 0, 1))
    radius = np.hypot((pieces[..., 0] - 20) / 10, (pieces[..., 1] - 0.75) / 0.3)
    assert np.abs(radius - 1).max() < 0.1
    length = np.linalg.norm(np.diff(pieces, axis=1)[:, 0] / [10, 0.3], axis=-1).sum()
    assert length == pytest.approx(2 * np.pi, rel=0.03), "all around, once"
