"""NAVSIM's two stages by hand; docs/metrics.md has the same numbers."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest

from recast.dynamics import state
from recast.planning.map import planner_map
from recast.planning.pdm import ExtendedScores
from recast_bridges.scores.two_stage import (
    COLUMNS,
    PlanScore,
    PlanSituation,
    SubmittedScene,
    TokenScore,
    TwoStageMapping,
    human_filtered,
    score_scene,
    second_stage_weights,
    two_stage,
    write_two_stage,
)
from support.made_up_rollouts import straight_plans
from support.straight_road import hd_road, straight, user

MAPPING = TwoStageMapping("a", "b", (("c", "d"), ("e", "f")))


def scores(**changes):
    names = ("no_collision", "drivable", "direction", "traffic_light")
    names += ("progress", "ttc", "lane_keeping", "history_comfort")
    return ExtendedScores(**{**dict.fromkeys(names, np.float64(1.0)), **changes})


def token(name, start_s=0.5, start=(0.0, 0.0), endpoint=(0.0, 0.0), **changes):
    plan = PlanScore(scores(**changes), straight(8.0))
    return TokenScore(name, name in "cdef", start_s, np.array(start), np.array(endpoint), plan)


def tokens():
    return [
        token("a", progress=0.8),
        token("b", 0.0),
        token("c", 4.5),
        token("d", 4.0, start=(30.0, 0.0)),
        token("e", 4.5, start=(0.4, 0.0), no_collision=0.0),
        token("f", 4.0, start=(30.0, 3.0), no_collision=0.5),
    ]


def test_weights_of_the_second_stage():
    # 0.4 m away: exp(-0.16 / 0.2) = 0.4493
    near = second_stage_weights((0.0, 0.0), [(0.0, 0.0), (0.4, 0.0)])
    np.testing.assert_allclose(near, [0.68997, 0.31003], atol=5e-6)
    far = second_stage_weights((0.0, 0.0), [(30.0, 0.0), (30.0, 3.0)])
    np.testing.assert_array_equal(far, 0.5)


def test_both_groups_and_their_mean():
    found = two_stage(tokens(), [MAPPING])
    assert found.rows["a"]["score"] == pytest.approx(15 / 16)
    assert found.rows["f"]["score"] == 0.5
    first, second = 15 / 16 * 0.68997, 1.0 * 0.75
    assert found.stage_one["score"] == pytest.approx((15 / 16 + 1) / 2)
    assert found.stage_one["ego_progress"] == pytest.approx(0.9)
    assert found.stage_two["score"] == pytest.approx((0.68997 + 0.75) / 2, abs=5e-6)
    assert found.combined == pytest.approx((first + second) / 2, abs=5e-6)
    assert found.combined == pytest.approx(0.69843, abs=5e-6)
    assert found.valid


def test_extended_comfort_belongs_to_both_of_a_pair():
    made = tokens()
    turned = straight(8.0, yaw_rate=0.2)
    made[4] = replace(made[4], plan=replace(made[4].plan, states=turned))
    found = two_stage(made, [MAPPING])
    comfort = {key: row["two_frame_extended_comfort"] for key, row in found.rows.items()}
    assert comfort == {"a": 1.0, "b": 1.0, "c": 1.0, "d": 1.0, "e": 0.0, "f": 0.0}
    assert found.rows["f"]["score"] == pytest.approx(0.5 * 14 / 16)


def test_a_failed_token_is_nan_and_takes_its_mapping_with_it(tmp_path):
    other = [replace(one, token=one.token.upper()) for one in tokens()]
    other[2] = replace(other[2], plan=None, reason="no plan was submitted")
    bad = TwoStageMapping("A", "B", (("C", "D"), ("E", "F")))
    found = two_stage([*tokens(), *other], [MAPPING, bad])
    assert all(np.isnan(value) for value in found.rows["C"].values())
    assert np.isnan(found.rows["D"]["score"])  # its pair has no EC
    assert found.combined == pytest.approx(two_stage(tokens(), [MAPPING]).combined)
    assert not found.valid


def test_the_table_has_navsims_rows_and_columns(tmp_path):
    path = tmp_path / "scores.csv"
    made = tokens()
    made.append(replace(token("g"), plan=None))
    write_two_stage(two_stage(made, [MAPPING]), path)
    with path.open(newline="") as file:
        lines = list(csv.DictReader(file))
    names = [name for name in COLUMNS if name != "score"]
    assert list(lines[0]) == [
        *("", "token", "valid"),
        *(f"{name}_stage_one" for name in names),
        *(f"{name}_stage_two" for name in names),
        "score",
    ]
    assert [line["token"] for line in lines] == [
        *"abcdefg",
        "extended_pdm_score_stage_one",
        "extended_pdm_score_stage_two",
        "extended_pdm_score_combined",
    ]
    assert [line[""] for line in lines] == [str(i) for i in range(10)]
    first, fourth, failed, one, two, both = (lines[i] for i in (0, 3, 6, 7, 8, 9))
    assert (first["ego_progress_stage_one"], first["ego_progress_stage_two"]) == ("0.8", "")
    assert (fourth["ego_progress_stage_one"], fourth["ego_progress_stage_two"]) == ("", "1.0")
    assert (failed["valid"], failed["score"], failed["ego_progress_stage_one"]) == ("False", "", "")
    assert one["ego_progress_stage_two"] == two["ego_progress_stage_one"] == ""
    assert float(both["ego_progress_stage_one"]) == pytest.approx(0.9)
    assert both["ego_progress_stage_two"] == two["ego_progress_stage_two"]
    assert float(both["score"]) == pytest.approx(0.69843, abs=5e-6)


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (tokens()[1:], "token 'a' was not scored"),
        ([*tokens(), tokens()[0]], "two scores have the same token"),
        ([replace(tokens()[0], start_s=0.7), *tokens()[1:]], r"interval 0\.7 s"),
    ],
)
def test_what_is_refused(made, message):
    with pytest.raises(ValueError, match=message):
        two_stage(made, [MAPPING])


def test_a_mapping_needs_a_second_stage():
    with pytest.raises(ValueError, match="is empty for token 'a'"):
        TwoStageMapping("a", "b", ())


def test_the_humans_zeros_are_forgiven():
    agent = scores(no_collision=0.0, drivable=0.0, direction=0.5, lane_keeping=0.0)
    human = scores(drivable=0.0, direction=0.5, lane_keeping=0.0)
    found = human_filtered(agent, human)
    assert (found.no_collision, found.drivable, found.direction) == (0.0, 1.0, 0.5)
    assert found.lane_keeping == 1.0


def scene(**changes):
    situation = PlanSituation(
        straight(10.0)[0], planner_map(hd_road()), ("ahead", "across", "beyond")
    )
    return replace(SubmittedScene("a", False, 12.0, situation), **changes)


def test_a_submitted_plan_is_scored_and_its_own_end_kept():
    plan = straight_plans(1, 10.0)[0][4::5]
    plan[:, 1] = 0.02 * np.arange(8)
    found = score_scene(scene(), plan)
    assert found.reason is None
    np.testing.assert_allclose(found.endpoint, [40.0, 0.14])
    assert found.plan.states[-1, state.Y] != pytest.approx(0.14, abs=1e-6)  # driven, not planned


def test_the_human_filters_original_scenes_only():
    # Both leave the road to the right.
    aside = straight_plans(1, 10.0)[0]
    aside[:, 1] = -0.1 * np.arange(40)
    made = scene(human=aside)
    assert score_scene(made, aside, 0.1).plan.scores.drivable == 1.0
    assert score_scene(replace(made, synthetic=True), aside, 0.1).plan.scores.drivable == 0.0
    assert score_scene(replace(made, human=None), aside, 0.1).plan.scores.drivable == 0.0


def test_a_plan_that_cannot_be_scored_is_failed():
    assert score_scene(scene(), None).reason == "no plan was submitted"
    short = score_scene(scene(), straight_plans(1, 10.0)[0][:30], 0.1)
    assert short.plan is None
    assert "ends at 3 s" in short.reason
    far = replace(scene().situation, state=straight(10.0, y=400.0)[0])
    lost = score_scene(scene(situation=far), straight_plans(1, 10.0)[0], 0.1)
    assert lost.plan is None
    assert "away from the nearest lane" in lost.reason


def test_red_lights_on_the_route_stop_the_score():
    red = {"across": np.ones(41, np.bool_), "oncoming": np.ones(41, np.bool_)}
    near = replace(scene().situation, state=straight(10.0, x=80.0)[0], red=red)
    crosses = score_scene(scene(situation=near), straight_plans(1, 10.0)[0], 0.1)
    assert crosses.plan.scores.traffic_light == 0.0
    away = replace(near, state=straight(10.0, x=10.0)[0], obstacles=(user(90.0, y=20.0),))
    away = replace(away, traffic=lambda states: np.tile([90.0, 20.0, 0.0], (1, 41, 1)))
    stays = score_scene(scene(situation=away), straight_plans(1, 10.0)[0], 0.1)
    assert stays.plan.scores.traffic_light == 1.0  # that of the oncoming lane is not the route's
