"""Aggregates and paired differences."""

import json
from dataclasses import replace

import numpy as np
import pytest

from recast.metrics import COLUMNS, matched_pairs, rollout_metrics, table
from recast.simulation.rollout import RolloutFailure
from support.made_up_rollouts import make_rollout, street


def crash(arm, ahead=6.0, **changes):
    rollout = make_rollout(steps=20, arm=arm, **changes)
    actor = np.tile([ahead, 0.0, 0.0, 0.0], (21, 1))
    return rollout_metrics(replace(rollout, actor=actor), street())


def clean(arm, **changes):
    return rollout_metrics(make_rollout(steps=20, arm=arm, **changes), street())


def test_columns_are_the_metrics():
    assert list(clean("native").values) == list(COLUMNS)
    assert [name for name, column in COLUMNS.items() if column.headline] == [
        "nc",
        "dac",
        "ttc",
        "r_c",
        "com",
        "com_driven",
    ]


def test_means_per_arm():
    rows = table([clean("native"), crash("native"), clean("native"), clean("recast")])
    assert [row.arm for row in rows] == ["native", "recast"]
    assert (rows[0].rollouts, rows[0].cut, rows[0].plans) == (3, 0, 12)
    assert rows[0].means["nc"] == pytest.approx(200 / 3)
    assert rows[0].means["ttc"] == pytest.approx(8 / 3)
    assert rows[1].means["nc"] == 100.0


def test_missing_values_are_left_out_and_counted():
    unmapped = rollout_metrics(make_rollout(steps=20), None)
    row = table([unmapped, clean("native")])[0]
    assert row.counts["dac"] == 1 and row.counts["nc"] == 2
    assert row.means["dac"] == 100.0
    alone = table([unmapped])[0]
    assert alone.means["dac"] is None
    json.dumps(alone.to_json(), allow_nan=False)


def test_cut_and_failed_rollouts_are_counted():
    failure = RolloutFailure("x", "recast", "7", "cut-in", "a", "idm", "ValueError", "why")
    short = clean("native", cut_reason="the log ends")
    rows = table([short], [failure])
    assert rows[0].cut == 1 and rows[0].failed == 0
    assert (rows[1].planner, rows[1].rollouts, rows[1].failed) == ("idm", 0, 1)
    assert [row.asked for row in rows] == [1, 1]
    assert rows[1].means["nc"] is None


def test_pairs_match_by_motion_and_setting():
    scenes = {
        "s1": [
            crash("native", motion="a"),
            clean("recast", motion="a"),
            clean("native", motion="b"),
            clean("recast", motion="b"),
        ],
        "s2": [clean("native", motion="a")],
        "s3": [
            clean("recast", motion="b"),
            crash("native", motion="b"),
            clean("recast", motion="c"),
        ],
    }
    pairs = matched_pairs(scenes, "recast", "native")
    found = pairs.of("nc")
    assert {scene: values.tolist() for scene, values in found.differences.items()} == {
        "s1": [1.0, 0.0],
        "s3": [1.0],
    }
    assert (found.pairs, found.plans, found.cut, found.asked) == (3, 12, 0, 5)


def test_a_pair_is_compared_up_to_the_end_of_the_shorter():
    """Cut before it could collide, a rollout is not better than the one that went on."""
    whole = crash("native", ahead=14.0)
    step = whole.collision.first_step
    assert 10 < step < 20
    cut = rollout_metrics(replace(whole.rollout.first(step - 1), arm="recast"), street())
    assert (cut.values["nc"].value, whole.values["nc"].value) == (1.0, 0.0)
    pairs = matched_pairs({"s": [whole, cut]}, "recast", "native")
    for name, column in COLUMNS.items():
        found = pairs.of(name)
        assert found.differences["s"].tolist() == [0.0], column.label
        assert (found.pairs, found.cut, found.plans) == (1, 1, cut.plans)


def test_a_failed_rollout_was_asked_for():
    failure = RolloutFailure("x", "recast", "7", "stationary", "b", "idm", "ValueError", "why")
    other = RolloutFailure("x", "other", "7", "stationary", "c", "idm", "ValueError", "why")
    scenes = {"s": [clean("native"), clean("recast")]}
    found = matched_pairs(scenes, "recast", "native", {"s": [failure, other], "t": [failure]})
    assert (found.of("nc").pairs, found.of("nc").asked) == (1, 3)
