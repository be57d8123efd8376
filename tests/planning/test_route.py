from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_paths import arc

from recast.core.errors import InputError
from recast.geometry import se2
from recast.logs.hdmap import HdMap, Lane
from recast.logs.types import Trajectory
from recast.planning import DrivingCommand, ReferenceRoute, route_lanes

curvatures = st.floats(-0.03, 0.03)


@given(curvature=curvatures, fraction=st.floats(0.0, 1.0), lateral=st.floats(-5.0, 5.0))
def test_frenet_round_trip(curvature: float, fraction: float, lateral: float) -> None:
    route = ReferenceRoute.from_trajectory(arc(seconds=8, curvature=curvature))
    s = fraction * route.length
    back = route.project(route.pose(s, lateral))
    np.testing.assert_allclose(back, [s, lateral], atol=0.05)


@given(curvature=curvatures)
def test_headings_are_continuous_and_match_the_circle(curvature: float) -> None:
    route = ReferenceRoute.from_trajectory(arc(seconds=8, curvature=curvature))
    s = np.arange(0.0, route.length, 0.05)
    heading = np.unwrap(route.heading(s))
    assert np.abs(np.diff(heading)).max() < 0.05 * abs(curvature) * 1.5 + 1e-6
    np.testing.assert_allclose(heading, curvature * s, atol=2e-3)


def test_length_and_speed_are_those_of_the_log() -> None:
    route = ReferenceRoute.from_trajectory(arc(speed=7.0, seconds=10, curvature=0.01))
    assert route.length == pytest.approx(70.0, abs=0.01)
    np.testing.assert_allclose(route.logged_speed([5.0, 35.0, 65.0]), 7.0, atol=0.01)


def test_centimetre_noise_leaves_the_heading_smooth() -> None:
    log = arc(speed=3.0, seconds=30)
    noisy = log.poses.copy()
    noisy[:, :2, 3] += np.random.default_rng(1).normal(0, 0.02, (len(noisy), 2))
    route = ReferenceRoute.from_trajectory(Trajectory(log.timestamps_us, noisy))
    assert np.abs(route.headings).max() < 0.06


def test_a_halt_in_the_log_adds_no_road() -> None:
    log = arc(seconds=10)
    jitter = np.random.default_rng(2).normal(0, 0.02, (50, 2))
    halted = np.concatenate([log.poses[:50], np.repeat(log.poses[50:51], 50, axis=0)])
    halted[50:, :2, 3] += jitter
    poses = np.concatenate([halted, log.poses[51:]])
    times = np.arange(len(poses), dtype=np.int64) * 100_000
    route = ReferenceRoute.from_trajectory(Trajectory(times, poses))
    assert route.length == pytest.approx(100.0, abs=0.1)
    assert route.logged_speed(51.0) < 2.0


def test_projection_goes_beyond_the_ends() -> None:
    route = ReferenceRoute.from_trajectory(arc(seconds=5))
    s, lateral = route.project([[-3.0, 1.0], [54.0, -2.0]])
    np.testing.assert_allclose(s, [-3.0, 54.0], atol=1e-9)
    np.testing.assert_allclose(lateral, [1.0, -2.0], atol=1e-9)


def test_a_standing_log_is_refused() -> None:
    with pytest.raises(InputError, match="no route"):
        ReferenceRoute.from_trajectory(arc(speed=0.1, seconds=8))


@pytest.mark.parametrize(
    ("curvature", "command"),
    [
        (0.02, DrivingCommand.LEFT),
        (-0.02, DrivingCommand.RIGHT),
        (0.0, DrivingCommand.STRAIGHT),
        (0.009, DrivingCommand.STRAIGHT),  # 20 m on, 1.8 m to the left
        (0.011, DrivingCommand.LEFT),  # 2.2 m
    ],
)
def test_command_of_arcs(curvature: float, command: DrivingCommand) -> None:
    route = ReferenceRoute.from_trajectory(arc(seconds=5, curvature=curvature))
    assert route.command(route.pose(10.0)) is command


def test_command_does_not_depend_on_the_ego_heading() -> None:
    route = ReferenceRoute.from_trajectory(arc(seconds=5))
    assert route.command([10.0, 1.0, 0.7]) is DrivingCommand.STRAIGHT


def test_command_is_unknown_off_the_ends() -> None:
    route = ReferenceRoute.from_trajectory(arc(seconds=5))
    assert route.command([-5.0, 0.0]) is DrivingCommand.UNKNOWN
    assert route.command([60.0, 0.0]) is DrivingCommand.UNKNOWN


def _lane(name: str, start: float, end: float, y: float, heading: float = 0.0) -> Lane:
    x = np.linspace(start, end, 5)
    line = np.stack([x, np.full(5, y), np.zeros(5)], axis=1)
    if heading:
        line = line[::-1]
    side = np.array([0.0, 1.75, 0.0])
    outline = np.array([[start, y - 2], [end, y - 2], [end, y + 2], [start, y + 2]])
    return Lane(name, line, line + side, line - side, outline)


def test_route_lanes_in_order_without_oncoming_and_distant_ones() -> None:
    lanes = [
        _lane("second", 25, 50, 0.5),
        _lane("first", 0, 25, 0.0),
        _lane("oncoming", 0, 50, 1.0, heading=np.pi),
        _lane("next", 0, 50, 3.5),
        _lane("elsewhere", 80, 120, 0.0),
    ]
    hdmap = HdMap({lane.lane_id: lane for lane in lanes}, ())
    route = ReferenceRoute.from_trajectory(arc(seconds=5))
    assert [lane.lane_id for lane in route_lanes(hdmap, route)] == ["first", "second"]


@given(x=st.floats(-100, 100), y=st.floats(-100, 100), turn=st.floats(-3, 3), curvature=curvatures)
def test_the_route_moves_with_the_world(x: float, y: float, turn: float, curvature: float) -> None:
    here = ReferenceRoute.from_trajectory(arc(seconds=5, curvature=curvature))
    there = ReferenceRoute.from_trajectory(
        arc(seconds=5, curvature=curvature, world_from_start=(x, y, turn))
    )
    s = np.linspace(0, min(here.length, there.length), 20)
    moved = se2.compose((x, y, turn), here.pose(s, 1.0))
    np.testing.assert_allclose(there.pose(s, 1.0)[:, :2], moved[:, :2], atol=1e-7)
    gap = se2.wrap_angle(there.pose(s)[:, 2] - moved[:, 2])
    np.testing.assert_allclose(gap, 0.0, atol=1e-7)
