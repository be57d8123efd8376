"""Routes that come back over themselves: loops, figure-of-eights, U-turns, and backing up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from recast.geometry import Polyline, se2
from recast.logs.types import DrivingLog, Track, Trajectory
from recast.metrics.driving import route_completion
from recast.planning import IdmLaneFollower, LogReplay, ReferenceRoute
from recast.simulation import LoggedMotion as Parked
from recast.simulation import RolloutSetup, Stationary, run_rollout

SPEED, COUNT = 8.0, 321


def poses_of(xy: NDArray) -> NDArray:
    heading = np.unwrap(np.arctan2(*np.gradient(xy, axis=0).T[::-1]))
    return np.concatenate([xy, heading[:, None]], axis=1)


def loop() -> NDArray:
    """Two laps and a half about a circle of 15 m."""
    turn = np.linspace(0.0, 5.0 * np.pi, COUNT)
    return 15.0 * np.stack([np.sin(turn), 1.0 - np.cos(turn)], axis=-1)


def eight() -> NDArray:
    turn = np.linspace(0.0, 2.0 * np.pi, COUNT)
    return np.stack([45.0 * np.sin(turn), 30.0 * np.sin(2.0 * turn)], axis=-1)


def u_turn() -> NDArray:
    """Ahead, about a half circle of 6 m, and back beside it."""
    s = np.linspace(0.0, 140.0, COUNT)
    turn = np.clip((s - 60.0) / 6.0, 0.0, np.pi)
    x = np.minimum(s, 60.0) + 6.0 * np.sin(turn) - np.maximum(s - 60.0 - 6.0 * np.pi, 0.0)
    return np.stack([x, 6.0 * (1.0 - np.cos(turn))], axis=-1)


def log_of(poses: NDArray) -> DrivingLog:
    times = (100_000 * np.arange(len(poses)) + 5_000_000).astype(np.int64)
    away = se2.to_se3(np.array([300.0, 300.0, 0.0]), 0.75)
    parked = Track(
        "7", "car", np.array([4.0, 1.8, 1.5]), Trajectory(times[[0, -1]], np.stack([away] * 2))
    )
    return DrivingLog("again", {}, {}, Trajectory(times, se2.to_se3(poses)), {"7": parked})


@pytest.mark.parametrize("shape", [loop, eight, u_turn])
def test_a_line_is_followed_past_places_that_it_meets_again(shape) -> None:  # type: ignore[no-untyped-def]
    line = Polyline(shape())
    aside = line.to_cartesian(line.arc_lengths, 0.3)
    np.testing.assert_allclose(line.follow(aside), line.arc_lengths, atol=0.6)
    share = route_completion(aside[:250], line.points).r_c_projection.value
    assert share == pytest.approx(line.arc_lengths[249] / line.length, abs=0.02)


@pytest.mark.parametrize("shape", [loop, eight, u_turn])
@pytest.mark.parametrize("planner", [LogReplay, IdmLaneFollower])
def test_a_rollout_goes_on_where_the_route_meets_itself(shape, planner) -> None:  # type: ignore[no-untyped-def]
    log = log_of(poses_of(shape()))
    motion = Stationary("a", min_gap=100.0, braking=4.0, reserve=0.0, lateral=-19.0)
    setup = RolloutSetup(log, "7", motion, steps=250, start_timestamp_us=5_000_000)
    rollout = run_rollout(setup, planner())
    assert (rollout.steps_run, rollout.cut_reason) == (250, None)
    route = ReferenceRoute.from_trajectory(log.world_from_rig)
    lateral = np.abs(route.project(rollout.ego)[1])
    assert lateral.max() < 2.5
    logged = rollout.log_ego[:, :2]
    driven = route.follow(rollout.ego, 0.0)[-1]
    assert driven == pytest.approx(route.follow(logged, 0.0)[-1], abs=6.0)


def backing() -> NDArray:
    """20 m ahead, a stop, and 20 m back."""
    times = 0.1 * np.arange(160)
    x = np.where(times < 7.0, 1.5 + 18.5 * np.sin(np.pi * np.minimum(times, 7.0) / 14.0), 20.0)
    x = x - 3.0 * np.maximum(times - 9.0, 0.0)
    return np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=-1)


def test_behind_a_log_that_backed_up_the_follower_stops() -> None:
    log = log_of(backing())
    setup = RolloutSetup(
        log, "7", Parked(), steps=150, start_timestamp_us=5_000_000, road_margin=0.0
    )
    rollout = run_rollout(setup, IdmLaneFollower())
    assert np.abs(se2.wrap_angle(rollout.ego[:, 2])).max() < 0.3
    assert rollout.ego[:, 0].max() < 23.0 and rollout.ego[-1, 3] < 0.3
    replay = run_rollout(replace(setup), LogReplay())
    assert replay.ego[-1, 3] == pytest.approx(-3.0, abs=0.05)
    np.testing.assert_allclose(replay.ego[:, :2], replay.log_ego[:, :2], atol=1e-9)
