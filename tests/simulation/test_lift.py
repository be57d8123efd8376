from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recast.geometry import boxes, se2, se3
from recast.logs.hdmap import GroundHeight
from recast.logs.types import DrivingLog
from recast.planning import ReferenceRoute
from recast.simulation import RoadSurface
from support.synthetic_drives import drive

SIZE = np.array([4.0, 2.0, 1.6])


def surface(log: DrivingLog, ground: GroundHeight | None = None) -> RoadSurface:
    trajectory = log.world_from_rig
    return RoadSurface.from_log(trajectory, ReferenceRoute.from_trajectory(trajectory), ground)


@given(curvature=st.floats(-0.02, 0.02), slope=st.floats(-0.1, 0.1))
def test_logged_planar_poses_lift_to_the_logged_poses(curvature: float, slope: float) -> None:
    log = drive(seconds=5, curvature=curvature, slope=slope)
    poses = log.world_from_rig.poses
    lifted = surface(log).ego_poses(se2.from_se3(poses))
    np.testing.assert_allclose(lifted, poses, atol=2e-3)


def test_the_lifted_heading_is_the_simulated_one() -> None:
    road = surface(drive(seconds=5, slope=0.05))
    planar = np.array([[20.0, 0.4, 0.3]])
    lifted = road.ego_poses(planar)
    np.testing.assert_allclose(se2.from_se3(lifted), planar, atol=1e-12)
    assert lifted[0, 2, 3] == pytest.approx(0.05 * 20.0, abs=1e-6)


def test_rolled_and_pitched_poses_come_back() -> None:
    log = drive(seconds=5)
    tilt = se3.exp([0, 0, 0, 0.03, -0.05, 0.0])
    tilted = log.world_from_rig.poses @ tilt
    trajectory = type(log.world_from_rig)(log.world_from_rig.timestamps_us, tilted)
    road = RoadSurface.from_log(trajectory, ReferenceRoute.from_trajectory(trajectory), None)
    np.testing.assert_allclose(road.ego_poses(se2.from_se3(tilted)), tilted, atol=1e-9)


@pytest.mark.parametrize("heading", [0.0, np.pi, 0.17 + np.pi, -0.3])
def test_the_actor_stands_on_the_sloped_road(heading: float) -> None:
    road = surface(drive(seconds=5, slope=0.08))
    planar = np.array([[25.0, 1.0, heading]])
    pose = road.actor_poses(planar, SIZE)
    bottom = boxes.corners(SIZE, pose)[0, :4]
    np.testing.assert_allclose(bottom[:, 2], 0.08 * bottom[:, 0], atol=0.01)
    assert se2.wrap_angle(se3.yaw(pose)[0] - heading) == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(pose[0, :3, :3] @ pose[0, :3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[0, :3, :3]) == pytest.approx(1.0)


def test_the_ground_grid_is_used_where_it_is_known() -> None:
    height = np.full((40, 100), 0.5)
    height[:, 60:] = np.nan
    ground = GroundHeight(np.array([0.0, -10.0]), 0.5, height)
    road = surface(drive(seconds=8), ground)
    known = road.actor_poses(np.array([[20.0, 3.5, 0.0]] * 3), SIZE)
    unknown = road.actor_poses(np.array([[60.0, 3.5, 0.0]] * 3), SIZE)
    np.testing.assert_allclose(known[:, 2, 3], 0.5 + 0.8, atol=1e-9)
    np.testing.assert_allclose(unknown[:, 2, 3], 0.8, atol=1e-9)


def test_heights_do_not_jump_at_cell_edges() -> None:
    height = np.where(np.arange(200) % 2, 0.1, 0.0) * np.ones((40, 1))
    ground = GroundHeight(np.array([0.0, -10.0]), 0.5, height)
    road = surface(drive(seconds=10), ground)
    planar = np.stack([np.linspace(5, 60, 100), np.zeros(100), np.zeros(100)], axis=1)
    z = road.actor_poses(planar, SIZE)[:, 2, 3]
    assert np.abs(np.diff(z)).max() < 0.01


def test_a_halt_in_the_log_is_harmless() -> None:
    log = drive(seconds=5, slope=0.05)
    trajectory = log.world_from_rig
    stopped = np.concatenate([trajectory.poses, np.repeat(trajectory.poses[-1:], 20, axis=0)])
    times = np.arange(len(stopped), dtype=np.int64) * 100_000
    halted = type(trajectory)(times, stopped)
    road = RoadSurface.from_log(halted, ReferenceRoute.from_trajectory(halted), None)
    assert np.all(np.diff(road.s) > 0)
    lifted = road.ego_poses(np.array([[50.0, 0.0, 0.0]]))
    assert lifted[0, 2, 3] == pytest.approx(2.5, abs=1e-6)
