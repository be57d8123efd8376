"""EPDMS of the plans of a rollout, on a straight road; docs/metrics.md has the same numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recast.dynamics import state, track
from recast.dynamics.tracker import PDM_REFERENCE
from recast.geometry import se2
from recast.planning.map import planner_map
from recast.planning.pdm import PdmClosed, PdmConfig
from recast_bridges.scores.driven import driven_epdms
from recast_bridges.scores.two_stage import PlanSituation, planned_poses, score_human, score_plan
from support.made_up_rollouts import make_rollout, moved_rollout, straight_plans
from support.straight_road import hd_road, straight, user

QUIRKS = PdmConfig(reference_quirks=True)
ROUTE = np.stack([np.linspace(0, 190, 381), np.zeros(381)], axis=-1)


def drive(speed=10.0, **changes):
    return make_rollout(**{"speed": speed, "steps": 40, "route": ROUTE, **changes})


def standing(x, y=0.0):
    return np.tile([x, y, 0.0, 0.0], (41, 1))


def test_an_ego_that_keeps_its_speed_loses_only_progress():
    rollout = drive(5.0)
    found = driven_epdms(rollout, hd_road())
    pdm = PdmClosed(planner_map(hd_road()), ("ahead", "across", "beyond"), config=QUIRKS)
    plan = pdm.plan(rollout.ego[0], [])
    driven = track(rollout.ego[0], plan.trajectory[:41], 40, PDM_REFERENCE)
    progress = 20.0 / (driven[-1, 0] - driven[0, 0])
    assert found.scores.progress[0] == pytest.approx(progress, rel=1e-9)
    np.testing.assert_array_equal(found.extended_comfort, 1.0)
    np.testing.assert_allclose(found.per_plan, (11 + 5 * found.scores.progress) / 16, rtol=1e-12)
    assert found.mean.value == pytest.approx(found.per_plan.mean())


def test_plans_that_reach_a_standing_car_score_nothing():
    # Its rear at 57.75 m; the front bumper at 4.05 + 10 t + 40: from step 15 on.
    found = driven_epdms(drive(actor=standing(60.0)), hd_road())
    assert found.scores.no_collision.tolist() == [1, 1, 1, 0, 0, 0, 0, 0]
    assert found.per_plan[3:].tolist() == [0.0] * 5
    assert found.mean.reason == "lowest score 0.00 at step 15"


def test_a_plan_unlike_the_one_before_is_uncomfortable_in_both_pairs():
    plans = straight_plans(8, 10.0)
    plans[3, :, 0] *= 0.8
    found = driven_epdms(drive(predictions=plans), hd_road())
    assert found.extended_comfort.tolist() == [1, 1, 1, 0, 0, 1, 1, 1]
    assert found.to_json()["means"]["extended_comfort"] == 0.75


def test_the_history_in_front_of_a_plan_is_what_was_driven():
    rollout = drive()
    ego = rollout.ego.copy()
    ego[5, state.AX] = -40.0
    found = driven_epdms(replace(rollout, ego=ego), hd_road())
    # Plans at steps 10, 15 and 20 have step 5 in their 1.5 s; the one at step 5 begins there.
    assert found.scores.history_comfort.tolist() == [1, 0, 0, 0, 0, 1, 1, 1]


def test_a_single_plan_has_no_extended_comfort():
    found = driven_epdms(drive().first(5), hd_road())
    assert len(found.per_plan) == 1
    assert np.isnan(found.extended_comfort[0])
    assert found.per_plan[0] == pytest.approx((9 + 5 * found.scores.progress[0]) / 14)
    assert "extended_comfort" not in found.to_json()["means"]


def test_the_place_in_the_world_does_not_matter():
    move = np.array([310.0, -125.0, 2.1])

    def points(line):
        flat = np.concatenate([line[:, :2], np.zeros((len(line), 1))], axis=1)
        return np.concatenate([se2.compose(move, flat)[:, :2], line[:, 2:]], axis=1)

    names = ("centreline", "left_boundary", "right_boundary", "polygon")
    lanes = {
        key: replace(lane, **{name: points(getattr(lane, name)) for name in names})
        for key, lane in hd_road().lanes.items()
    }
    rollout = drive(actor=standing(60.0, 2.0))
    here = driven_epdms(rollout, hd_road())
    there = driven_epdms(moved_rollout(rollout, move), replace(hd_road(), lanes=lanes))
    np.testing.assert_allclose(there.per_plan, here.per_plan, rtol=0, atol=1e-7)


@pytest.mark.parametrize(
    ("rollout", "hd_map", "reason"),
    [
        (drive(), None, "no lanes in the map"),
        (
            drive(dt=0.2),
            hd_road(),
            "NAVSIM's rules need steps of 0.1 s, but the drive has steps of 0.2 s",
        ),
        (
            drive(predictions=np.zeros((0, 40, 3)), plan_steps=np.zeros(0, np.int64)),
            hd_road(),
            "no plan was made",
        ),
    ],
)
def test_why_there_is_no_value(rollout, hd_map, reason):
    found = driven_epdms(rollout, hd_map)
    assert (found.mean.value, found.mean.reason) == (None, reason)
    assert found.to_json()["means"] == {}


def test_an_ego_far_from_the_route_has_no_value():
    found = driven_epdms(drive(route=ROUTE + np.array([0.0, 500.0])), hd_road())
    assert found.mean.value is None
    assert "no lane of the map lies within" in found.mean.reason


def test_traffic_answers_to_the_plan_and_not_to_pdm_closed():
    seen = []

    def traffic(states):
        seen.append(states)
        return np.zeros((1, 41, 3)) + np.array([100.0, 0.0, 0.0])

    start = straight(10.0)[0]
    lanes = planner_map(hd_road())
    here = PlanSituation(start, lanes, ("ahead", "across"), (user(100.0),), traffic)
    plan = score_plan(here, straight_plans(1, 6.0)[0])
    np.testing.assert_array_equal(seen[0], plan.states)
    human = score_human(here, straight_plans(1, 6.0)[0])
    assert human.scores.progress == 1.0
    assert human.scores.history_comfort == 1.0


def test_a_plan_of_eight_poses_is_joined_by_straight_lines():
    here = PlanSituation(straight(8.0)[0], planner_map(hd_road()), ("ahead",))
    coarse = straight_plans(1, 8.0)[0][4::5]
    coarse[:, 2] = np.pi - 0.1 * np.arange(8)
    found = planned_poses(here, coarse, 0.5)
    np.testing.assert_allclose(found[:, 0], 0.8 * np.arange(41), atol=1e-12)
    np.testing.assert_allclose(np.diff(found[5:, 2]), -0.02, atol=1e-12)
    with pytest.raises(ValueError, match=r"the plan ends at 3\.5 s, 4 s are needed"):
        planned_poses(here, coarse[:7], 0.5)
