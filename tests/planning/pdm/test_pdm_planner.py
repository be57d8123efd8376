"""PDM-Closed on the planner seam: a log's map, actors, 40 waypoints in the ego frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.dynamics import PACIFICA, make_state, track
from recast.dynamics import state as ego
from recast.geometry import boxes, se2
from recast.logs.hdmap import HdMap, Lane
from recast.logs.types import Trajectory
from recast.planning import (
    ActorState,
    DrivingCommand,
    PlannerInput,
    PlanningContext,
    ReferenceRoute,
    make_planner,
)
from recast.planning.pdm import AgentKind, Obstacle, PdmClosedPlanner

START = np.array([40.0, 25.0, 0.7])  # the road in the world


def road_lane(key, lateral, **links) -> Lane:
    x = np.arange(0.0, 201.0, 2.0)

    def line(y):
        poses = se2.compose(START, np.stack([x, np.full_like(x, y), 0 * x], axis=-1))
        return np.c_[poses[:, :2], np.zeros(len(x))]

    left, right = line(lateral + 1.75), line(lateral - 1.75)
    outline = np.concatenate([right, left[::-1]])[:, :2]
    return Lane(key, line(lateral), left, right, outline, 10.0, **links)


def context(hdmap: HdMap | None) -> PlanningContext:
    x = np.arange(10.0, 150.0, 1.0)
    poses = se2.compose(START, np.stack([x, 0 * x, 0 * x], axis=-1))
    times = (100_000 * np.arange(len(x))).astype(np.int64)
    trajectory = Trajectory(times, se2.to_se3(poses))
    return PlanningContext(ReferenceRoute.from_trajectory(trajectory), trajectory, hdmap)


def road() -> HdMap:
    lanes = [
        road_lane("ego", 0.0, left_neighbour="left"),
        road_lane("left", 3.5, right_neighbour="ego"),
    ]
    return HdMap({lane.lane_id: lane for lane in lanes}, ())


def car(x, y=0.0, speed=0.0, category="car", track_id="1") -> ActorState:
    pose = se2.compose(START, np.array([x, y, 0.0]))
    velocity = speed * np.array([np.cos(START[2]), np.sin(START[2])])
    return ActorState(track_id, category, pose, velocity, np.array([4.5, 1.9, 1.5]))


def observe(state, *actors) -> PlannerInput:
    return PlannerInput(0, 0, state, state[None], actors, DrivingCommand.STRAIGHT)


def start(speed: float) -> np.ndarray:
    return make_state(se2.compose(START, np.array([10.0, 0.0, 0.0])), speed)


def test_it_drives_on_along_the_road():
    planner = make_planner("pdm-closed")
    planner.reset(context(road()))
    plan = planner.plan(observe(start(8.0)))
    plan.validate()
    assert np.all(np.diff(plan.waypoints[:, 0]) > 0.75)
    np.testing.assert_allclose(plan.waypoints[:, 1:], 0.0, atol=1e-9)
    assert plan.info["score"] == pytest.approx(1.0)
    assert plan.info["emergency_brake"] == 0.0


def test_it_stops_behind_a_standing_car_and_starts_when_it_leaves():
    planner = PdmClosedPlanner()
    planner.reset(context(road()))
    state, obstacle = start(7.0), car(40.0)
    for _ in range(14):
        waypoints = planner.plan(observe(state, obstacle)).waypoints
        poses = se2.compose(state[ego.POSE], np.concatenate([np.zeros((1, 3)), waypoints]))
        states = track(state, poses, 5)
        for pose in states[1:, ego.POSE]:
            centre = se2.compose(pose, np.array([PACIFICA.centre_offset, 0.0, 0.0]))
            size = (PACIFICA.length, PACIFICA.width)
            assert boxes.bev_overlap_area(centre, size, obstacle.pose, obstacle.size) == 0.0
        state = states[-1]
    assert state[ego.VX] < 1.0
    stopped = se2.relative(START, state[ego.POSE])[0]
    assert 27.0 < stopped < 40.0 - 2.25 - PACIFICA.front_length
    assert planner.plan(observe(state)).waypoints[-1, 0] > 5.0


def test_reset_forgets_the_drive_before():
    planner = PdmClosedPlanner()
    planner.reset(context(road()))
    first = planner.plan(observe(start(8.0), car(30.0))).waypoints
    planner.plan(observe(start(8.0), car(13.0)))  # touched, and ignored from now on
    ignored = planner.plan(observe(start(8.0), car(30.0))).waypoints
    assert ignored[-1, 0] > first[-1, 0] + 5.0
    planner.reset(context(road()))
    np.testing.assert_array_equal(planner.plan(observe(start(8.0), car(30.0))).waypoints, first)


@pytest.mark.parametrize(
    ("category", "kind"),
    [
        ("van", AgentKind.VEHICLE),
        ("misc", AgentKind.VEHICLE),
        ("pedestrian", AgentKind.PEDESTRIAN),
        ("cyclist", AgentKind.BICYCLE),
    ],
)
def test_categories(category, kind):
    assert Obstacle.from_actor(car(0.0, category=category)).kind is kind


def test_bad_input_is_one_line():
    planner = PdmClosedPlanner()
    with pytest.raises(RuntimeError, match="call reset first"):
        planner.plan(observe(start(5.0)))
    with pytest.raises(InputError, match="map: the log has no map"):
        planner.reset(context(None))
    with pytest.raises(InputError, match="lanes: are missing"):
        planner.reset(context(replace(road(), lanes={})))
    off = HdMap({"far": road_lane("far", 40.0)}, ())
    with pytest.raises(InputError, match="no lane of the map lies within"):
        planner.reset(context(off))
