"""Matching sweeps corrects a trajectory that wanders, and leaves a good one alone."""

from __future__ import annotations

import numpy as np
import pytest

from recast.geometry import se3
from recast.logs import DrivingLog, LidarStream, LidarSweep, Trajectory
from recast.logs.motion import (
    adjoint,
    heading_offset,
    match,
    refine_trajectory,
    surfels,
    thin,
)


def room(rng: np.random.Generator) -> np.ndarray:
    """Points on floor, walls and a few boxes, (N, 3), in the room's frame."""
    parts = []
    for axis, place in ((2, 0.0), (1, 7.0), (1, -8.0), (0, 30.0), (0, -12.0)):
        points = rng.uniform([-12, -8, 0], [30, 7, 4], (12000, 3))
        points[:, axis] = place
        parts.append(points)
    for centre in ([5.0, 4.0], [14.0, -5.0], [20.0, 3.0]):
        points = rng.uniform(-1.0, 1.0, (4000, 3))
        axis = rng.integers(0, 3, 4000)
        points[np.arange(4000), axis] = np.sign(points[np.arange(4000), axis])
        parts.append(points + np.array([*centre, 1.0]))
    return np.concatenate(parts) + rng.normal(0, 0.005, (72000, 3))


def drive_through(wander: float) -> tuple[LidarStream, Trajectory, Trajectory]:
    """Sweeps of a car in the room, its true trajectory and a recorded one that wanders."""
    rng = np.random.default_rng(3)
    times = 1_000_000 + 100_000 * np.arange(12, dtype=np.int64)
    steps = np.tile([0.6, 0.0, 0.0, 0.0, 0.0, 0.02], (12, 1)) * np.arange(12)[:, None]
    truth = Trajectory(times, se3.exp(steps))
    phase = np.sin(np.linspace(0.0, 2 * np.pi, 12))[:, None]
    off = se3.exp(phase * wander * np.array([0.0, 1.0, 0.3, 0.0, 0.0, 0.02]))
    sweeps = []
    for time, pose in zip(times, truth.poses, strict=True):
        points = se3.apply(se3.inverse(pose), room(rng)).astype(np.float32)
        sweeps.append(LidarSweep(int(time), points, np.zeros(len(points), np.float32)))
    lidar = LidarStream("top", np.eye(4), times, sweeps)
    return lidar, truth, Trajectory(times, truth.poses @ off)


def relative_error(trajectory: Trajectory, truth: Trajectory) -> float:
    """Largest error in metres of a place seen from the first pose."""
    mine = se3.inverse(trajectory.poses[0]) @ trajectory.poses
    true = se3.inverse(truth.poses[0]) @ truth.poses
    return float(np.linalg.norm(mine[:, :3, 3] - true[:, :3, 3], axis=1).max())


def test_wandering_poses_are_pulled_back() -> None:
    lidar, truth, recorded = drive_through(wander=0.3)
    assert relative_error(recorded, truth) > 0.25
    refined = refine_trajectory(lidar, recorded)
    np.testing.assert_array_equal(refined.timestamps_us, recorded.timestamps_us)
    assert relative_error(refined, truth) < 0.04


def test_good_poses_stay() -> None:
    lidar, truth, recorded = drive_through(wander=0.0)
    assert relative_error(refine_trajectory(lidar, recorded), truth) < 0.015


def test_one_sweep_cannot_be_matched(tiny_log: DrivingLog) -> None:
    lidar = tiny_log.lidars["velodyne"]
    alone = LidarStream("one", lidar.rig_from_lidar, lidar.timestamps_us[:1], [lidar.sweeps[0]])
    assert refine_trajectory(alone, tiny_log.world_from_rig) is tiny_log.world_from_rig


def test_empty_sweeps_leave_the_recorded_poses() -> None:
    lidar, _, recorded = drive_through(wander=0.3)
    nothing = LidarSweep(0, np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
    empty = LidarStream("top", np.eye(4), lidar.timestamps_us, [nothing] * 12)
    refined = refine_trajectory(empty, recorded)
    np.testing.assert_allclose(refined.poses, recorded.poses, atol=1e-9)


def test_a_tunnel_leaves_the_guess_alone_along_it() -> None:
    rng = np.random.default_rng(0)
    walls = room(rng)[:36000]  # floor and the two long walls only
    world = surfels(walls, thin(walls))
    guess = se3.exp(np.array([0.3, 0.2, 0.0, 0.0, 0.0, 0.0]))  # truth: identity
    pose = match(thin(walls), world, guess)
    assert pose[0, 3] == pytest.approx(0.3, abs=0.02)
    assert pose[1, 3] == pytest.approx(0.0, abs=0.02)


def test_adjoint_moves_a_twist_to_the_other_side() -> None:
    rng = np.random.default_rng(1)
    pose, twist = se3.exp(rng.normal(size=6)), 1e-3 * rng.normal(size=6)
    np.testing.assert_allclose(
        pose @ se3.exp(twist), se3.exp(adjoint(pose) @ twist) @ pose, atol=1e-12
    )


@pytest.mark.parametrize("turn", [0.0, 0.3, -0.2])
def test_heading_offset_is_the_yaw_of_the_mounting(turn: float) -> None:
    """Also on a circle, where the chord points half a turn off the start's heading."""
    times = 100_000 * np.arange(20, dtype=np.int64)
    twist = np.array([1.0, 0.0, 0.0, 0.0, 0.0, turn])
    poses = se3.exp(twist * np.arange(20)[:, None])
    off = se3.from_rotation_translation(se3.rotation_z(0.02), np.zeros(3))
    assert heading_offset(Trajectory(times, poses)) == pytest.approx(0.0, abs=1e-9)
    mounted = Trajectory(times, poses @ se3.inverse(off))
    assert heading_offset(mounted) == pytest.approx(0.02, abs=1e-9)
    crawling = Trajectory(times * 1000, poses @ se3.inverse(off))
    assert heading_offset(crawling) == 0.0
    reversing = Trajectory(times, mounted.poses[::-1])
    assert heading_offset(reversing) == pytest.approx(0.02, abs=1e-9)


def test_a_heading_that_no_mounting_explains_is_left() -> None:
    times = 100_000 * np.arange(20, dtype=np.int64)
    poses = se3.exp(np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]) * np.arange(20)[:, None])
    off = se3.from_rotation_translation(se3.rotation_z(0.3), np.zeros(3))
    assert heading_offset(Trajectory(times, poses @ off)) == 0.0
