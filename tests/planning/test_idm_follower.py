from __future__ import annotations

import numpy as np
import pytest
from recorded_paths import arc, car, context, observe

from recast.logs.hdmap import HdMap, Lane
from recast.planning import ActorState, IdmLaneFollower, PlannerInput, PlanningContext


def plan_x(observation: PlannerInput, log_speed: float = 10.0) -> np.ndarray:
    planner = IdmLaneFollower()
    planner.reset(context(arc(speed=log_speed)))
    return planner.plan(observation).waypoints


def speeds(waypoints: np.ndarray) -> np.ndarray:
    points = np.concatenate([np.zeros((1, 2)), waypoints[:, :2]])
    return np.linalg.norm(np.diff(points, axis=0), axis=1) / 0.1


def test_free_road_keeps_the_logged_speed() -> None:
    np.testing.assert_allclose(speeds(plan_x(observe((0, 0, 0), 10.0))), 10.0, atol=0.02)


def test_too_slow_speeds_up_within_the_idm_limit() -> None:
    v = speeds(plan_x(observe((0, 0, 0), 5.0)))
    assert v[-1] > 7.5
    assert np.diff(v).max() <= 0.1 + 1e-9


@pytest.mark.parametrize(
    "actor",
    [
        car(45.0, 0.0),  # stands
        car(45.0, 0.0, np.pi, vx=-5.0),  # comes towards the ego
        car(25.0, 0.0, vx=4.0),  # drives slowly
        car(15.0, 3.2, vx=6.0, vy=-1.5),  # is about to cut in
        car(25.0, -6.0, np.pi / 2, vy=3.0),  # crosses from the right
    ],
    ids=["stationary", "oncoming", "slow", "cut-in", "crossing"],
)
def test_brakes_for_what_is_or_will_be_in_the_way(actor: ActorState) -> None:
    assert speeds(plan_x(observe((0, 0, 0), 10.0, actor)))[-1] < 8.0


@pytest.mark.parametrize(
    "actor",
    [
        car(30.0, 3.5),  # parked in the next lane
        car(30.0, -3.5, np.pi, vx=-8.0),  # oncoming in the next lane
        car(-12.0, 0.0, vx=15.0),  # behind
        car(30.0, 3.5, vx=12.0),  # faster in the next lane
        car(80.0, 0.0, vx=12.0),  # ahead, driving off
    ],
    ids=["parked", "oncoming-beside", "behind", "faster-beside", "leaving"],
)
def test_does_not_brake_for_what_is_not_in_the_way(actor: ActorState) -> None:
    assert speeds(plan_x(observe((0, 0, 0), 10.0, actor))).min() > 9.5


def test_does_not_rush_past_a_moving_car_in_the_next_lane() -> None:
    v = speeds(plan_x(observe((0, 0, 0), 10.0, car(15.0, 3.5, vx=5.0))))
    assert v[10] < 8.0


def test_stops_behind_a_standing_car_within_the_plan() -> None:
    waypoints = plan_x(observe((0, 0, 0), 6.0, car(22.0, 0.0)))
    # front bumper at 4.049 m ahead of the rear axle, the car's rear at 20 m
    assert waypoints[-1, 0] + 4.049 < 20.0
    assert speeds(waypoints)[-1] < 1.0
    assert np.all(np.diff(waypoints[:, 0]) >= 0)


def test_follows_bends_and_sees_leads_in_them() -> None:
    log = arc(speed=10.0, curvature=0.02)
    planner = IdmLaneFollower()
    planner.reset(context(log))
    free = planner.plan(observe((0, 0, 0), 10.0)).waypoints
    np.testing.assert_allclose(
        np.hypot(free[:, 0], free[:, 1] - 50.0), 50.0, atol=0.02
    )  # stays on the circle
    ahead = 0.02 * 30.0
    lead = car(50 * np.sin(ahead), 50 * (1 - np.cos(ahead)), ahead)
    assert speeds(planner.plan(observe((0, 0, 0), 10.0, lead)).waypoints)[-1] < 3.0


def test_comes_back_to_the_route_smoothly() -> None:
    waypoints = plan_x(observe((0, 1.5, 0.1), 8.0))
    offset = 1.5 + waypoints[:, 0] * np.sin(0.1) + waypoints[:, 1] * np.cos(0.1)
    assert abs(offset[-1]) < 0.02
    assert np.abs(np.diff(offset)).max() < 0.15
    travelled = np.diff(np.concatenate([[[0.0, 0.0]], waypoints[:, :2]]), axis=0)
    course = np.arctan2(travelled[:, 1], travelled[:, 0])
    # headings are those of the motion
    np.testing.assert_allclose(waypoints[1:, 2], course[1:], atol=0.03)


def test_a_lane_speed_limit_is_the_target() -> None:
    x = np.linspace(0, 200, 50)
    line = np.stack([x, np.zeros(50), np.zeros(50)], axis=1)
    side = np.array([0.0, 1.75, 0.0])
    outline = np.array([[0, -2], [200, -2], [200, 2], [0, 2.0]])
    lane = Lane("l", line, line + side, line - side, outline, speed_limit=6.0)
    log = arc(speed=10.0)
    plain = context(log)
    planner = IdmLaneFollower()
    planner.reset(PlanningContext(plain.route, log, HdMap({"l": lane}, ())))
    assert speeds(planner.plan(observe((0, 0, 0), 6.0)).waypoints).max() <= 6.0 + 1e-6


def test_a_halt_in_the_log_does_not_hold_the_ego() -> None:
    v = speeds(plan_x(observe((0, 0, 0), 1.0), log_speed=1.0))
    assert v[-1] > 2.0


def test_same_input_same_plan() -> None:
    observation = observe((0, 0.3, 0), 9.0, car(30.0, 0.2, vx=3.0))
    np.testing.assert_array_equal(plan_x(observation), plan_x(observation))
