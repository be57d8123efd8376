"""The table of a grid: failures counted, intervals hold the mean, verdicts against the truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from recast.dynamics.state import moved_left
from recast.metrics import COLUMNS
from recast.metrics.table import script_difference
from recast.studies.grid import GridRow, arm_summaries, paired_summaries
from recast.studies.verdicts import (
    SCHEMA,
    VerdictPart,
    agreements,
    noise_floors,
    part_losses,
    verdicts,
    write_rows,
)
from support.made_up_rollouts import make_rollout


def row(scene: str, arm: str, setting: str, nc: float, ttc: float) -> GridRow:
    scores = {**dict.fromkeys(COLUMNS, 1.0), "nc": nc, "ttc": ttc}
    return GridRow(
        scene,
        None,
        None,
        "cut-in",
        setting,
        arm,
        "p",
        steps_run=160,
        plan_steps=tuple(range(0, 160, 5)),
        scores=scores,
    )


def cut(whole: GridRow, steps: int) -> GridRow:
    """The same row, cut."""
    plans = tuple(step for step in whole.plan_steps if step < steps)
    return replace(whole, steps_run=steps, plan_steps=plans, cut_reason="the log ends")


def failed(scene: str, arm: str, setting: str) -> GridRow:
    return row(scene, arm, setting, 1.0, 1.0).failed("ValueError", "NaN at waypoint 3")


ROWS = [
    row("one", "native", "a", 0.0, 0.0),
    row("one", "replaced", "a", 1.0, 4.0),
    row("one", "oracle", "a", 1.0, 4.0),
    row("one", "native", "b", 0.0, 1.0),
    failed("one", "replaced", "b"),
    row("one", "oracle", "b", 0.0, 0.5),
    row("two", "native", "a", 1.0, 4.0),
    row("two", "replaced", "a", 0.0, 2.0),
    row("two", "oracle", "a", 1.0, 4.0),
]


def test_means_are_over_what_was_scored_and_lie_in_their_intervals() -> None:
    native, replaced, oracle = arm_summaries(ROWS, 500, 0)
    assert [x.row.arm for x in (native, replaced, oracle)] == ["native", "replaced", "oracle"]
    assert (replaced.row.rollouts, replaced.row.failed) == (2, 1)
    assert native.row.means["nc"] == pytest.approx(100 / 3)
    assert (native.intervals["nc"].low, native.intervals["nc"].high) == (0.0, 100.0)
    for line in (native, replaced, oracle):
        for name, interval in line.intervals.items():
            assert interval.point == pytest.approx(line.row.means[name])
            assert interval.low <= interval.point <= interval.high


def test_differences_are_of_pairs_and_have_an_exact_reading() -> None:
    found = {(d.candidate, d.metric): d for d in paired_summaries(ROWS, "native", 500, 0)}
    nc = found["replaced", "nc"]
    assert (nc.pairs, nc.scenes) == (2, 2)  # the pair with the failed rollout is left out
    assert (nc.asked, nc.plans, nc.cut) == (3, 64, 0)
    assert nc.sampled.point == 0.0 and nc.exact is not None
    assert (nc.exact.low, nc.exact.high) == (-100.0, 100.0)
    assert found["oracle", "ttc"].sampled.point == pytest.approx((4.0 - 0.5 + 0.0) / 3)
    assert not any(candidate == "native" for candidate, _ in found)


def test_too_many_scenes_to_enumerate_are_only_sampled() -> None:
    rows = [row(str(i), m, "a", i % 2, 1.0) for i in range(12) for m in ("native", "replaced")]
    assert all(d.exact is None for d in paired_summaries(rows, "native", 50, 0))


def test_verdicts_against_the_oracle() -> None:
    found = verdicts(ROWS, "oracle")
    assert [v is None for v in found] == [False, False, True, False, True, True, False, False, True]
    assert found[0] is not None and (found[0].agrees, found[0].ttc_error) == (False, -4.0)
    native, replaced = agreements(ROWS, "oracle", 500, 0)
    assert (native.agreeing, native.pairs, native.scenes) == (2, 3, 2)
    assert (native.false_collisions, native.missed_collisions) == (1, 0)
    assert native.ttc_error is not None and native.ttc_error.point == pytest.approx(1.5)
    assert (replaced.agreeing, replaced.pairs) == (1, 2)
    assert (replaced.asked, replaced.plans, replaced.cut) == (3, 64, 0)


def test_what_was_cut_is_compared_up_to_there() -> None:
    """Without that, the replaced car would miss a collision for which it had no time."""
    early = {**dict.fromkeys(COLUMNS, 1.0), "nc": 1.0, "ttc": 3.0}
    oracle = replace(row("one", "oracle", "a", 0.0, 0.5), shorter={60: early})
    native = replace(row("one", "native", "a", 0.0, 0.5), shorter={60: early})
    replaced = cut(row("one", "replaced", "a", 1.0, 3.5), 60)
    rows = [native, replaced, oracle]
    first, second = agreements(rows, "oracle", 50, 0)
    assert (first.arm, first.agreeing, first.cut, first.plans) == ("native", 1, 0, 32)
    assert (second.arm, second.agreeing, second.cut, second.plans) == ("replaced", 1, 1, 12)
    assert second.missed_collisions == 0
    assert second.ttc_error is not None and second.ttc_error.point == 0.5
    found = {(d.candidate, d.metric): d for d in paired_summaries(rows, "native", 50, 0)}
    nc = found["replaced", "nc"]
    assert (nc.sampled.point, nc.cut, nc.plans) == (0.0, 1, 12)


def test_nothing_is_compared_where_the_oracle_failed() -> None:
    rows = [row("one", "native", "a", 0.0, 0.0), failed("one", "oracle", "a")]
    assert agreements(rows, "oracle", 50, 0) == []


def test_the_noise_floor_pools_the_disturbed_truths() -> None:
    noisy = [
        row("one", "oracle:seed", "a", 1.0, 4.0),
        row("one", "oracle:grey", "a", 0.0, 4.0),
        row("two", "oracle:seed", "a", 1.0, 4.0),
        failed("two", "oracle:grey", "a"),
    ]
    rows = [*ROWS, *noisy]
    [floor] = noise_floors(rows, "oracle", ["oracle:seed", "oracle:grey"], 500, 0)
    assert (floor.arm, floor.agreeing, floor.pairs, floor.asked) == ("noise floor", 2, 3, 4)
    assert floor.share.point == pytest.approx(2 / 3)
    native = agreements(rows, "oracle", 500, 0)[0]
    assert native.over(floor) == pytest.approx((2 / 3) / (2 / 3))
    assert native.over(None) is None
    assert native.over(replace(floor, agreeing=0)) is None
    assert noise_floors(ROWS, "oracle", [], 500, 0) == []


def test_parts_lose_agreement_on_the_scenarios_of_both() -> None:
    parts = [
        VerdictPart("vehicle", "native", "replaced"),
        VerdictPart("street", "oracle", "native"),
    ]
    vehicle, street = part_losses(
        ROWS, "oracle", [*parts, VerdictPart("light", "native", "no")], 500, 0
    )
    # one-b has no replaced: native disagrees and agrees, replaced agrees and disagrees
    assert (vehicle.pairs, vehicle.scenes) == (2, 2)
    assert (vehicle.agreeing, vehicle.other_agreeing, vehicle.loss.point) == (1, 1, 0.0)
    assert (vehicle.loss.low, vehicle.loss.high) == (-1.0, 1.0)
    assert (street.pairs, street.agreeing, street.other_agreeing) == (3, 3, 2)
    assert street.loss.point == pytest.approx(1 / 3)


def test_a_start_beside_the_log_s_is_the_same_script_only_where_it_is_asked_for() -> None:
    rollout = make_rollout()
    ego = rollout.ego.copy()
    ego[0] = moved_left(rollout.ego[0], 0.05)
    beside = make_rollout(ego=ego)
    assert script_difference(rollout, beside) == "the ego's first state differs"
    assert script_difference(rollout, beside, 0.05) is None
    assert script_difference(rollout, rollout, 0.05) == "the ego's first state differs"


def test_the_file_holds_every_column_and_is_the_same_twice(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_rows(ROWS, tmp_path / name, "oracle")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    table = pq.read_table(tmp_path / "a")
    assert table.schema.names == SCHEMA.names
    record = table.to_pylist()[4]
    assert record["failure_reason"] == "NaN at waypoint 3"
    assert record["nc"] is None and record["verdict"] is None and record["plans"] is None
    first = table.to_pylist()[0]
    assert first["oracle_verdict"] == "no collision"
    assert (first["plans"], first["plans_compared"]) == (32, 32)


def test_a_shorter_rollout_has_the_same_script_and_a_moved_actor_has_not() -> None:
    whole, short = make_rollout(), make_rollout(steps=80)
    assert script_difference(whole, short) is None
    actor = whole.actor.copy()
    actor[30, 0] += 1e-12
    other = make_rollout(actor=actor)
    assert "from step 30" in (script_difference(whole, other) or "")
    assert "start_timestamp_us" in (
        script_difference(whole, make_rollout(start_timestamp_us=5)) or ""
    )
    assert np.array_equal(whole.route, short.route)
