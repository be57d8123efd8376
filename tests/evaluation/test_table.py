"""Aggregates and paired differences."""

import json
from dataclasses import replace

import numpy as np
import pytest

from recast.evaluation import COLUMNS, paired_differences, rollout_metrics, table
from recast.simulation.rollout import RolloutFailure

from .rollouts import make_rollout, street


def crash(method, **changes):
    rollout = make_rollout(steps=20, method=method, **changes)
    actor = np.tile([6.0, 0.0, 0.0, 0.0], (21, 1))
    return rollout_metrics(replace(rollout, actor=actor), street())


def clean(method, **changes):
    return rollout_metrics(make_rollout(steps=20, method=method, **changes), street())


def test_columns_are_the_metrics():
    assert list(clean("native").values) == list(COLUMNS)
    assert [name for name, column in COLUMNS.items() if column.headline] == [
        "nc",
        "dac",
        "ttc",
        "r_c",
        "com",
    ]


def test_means_per_method():
    rows = table([clean("native"), crash("native"), clean("native"), clean("recast")])
    assert [row.method for row in rows] == ["native", "recast"]
    assert rows[0].rollouts == 3 and rows[0].cut == 0
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
    found = paired_differences(scenes, "nc", "recast", "native")
    assert {scene: values.tolist() for scene, values in found.items()} == {
        "s1": [1.0, 0.0],
        "s3": [1.0],
    }
