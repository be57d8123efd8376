from __future__ import annotations

import numpy as np

from recast.actors.evidence import free_space
from recast.logs import DrivingLog, LidarStream, LidarSweep, Track, Trajectory
from support import made_up_actors as made_up

CENTRE = np.array([10.0, 0.0, made_up.SIZE[2] / 2])


def log_of(points: np.ndarray, sweeps: int) -> DrivingLog:
    """A LiDAR at the origin, 1 m up, and a box ahead of it, `sweeps` times the same."""
    times = np.arange(sweeps, dtype=np.int64) * made_up.STEP_US
    still = np.tile(np.eye(4), (sweeps, 1, 1))
    mount = np.eye(4)
    mount[2, 3] = 1.0
    poses = still.copy()
    poses[:, :3, 3] = CENTRE
    sweep = [
        LidarSweep(int(time), points.astype(np.float32), np.zeros(len(points), np.float32))
        for time in times
    ]
    track = Track("7", "car", made_up.SIZE, Trajectory(times, poses))
    return DrivingLog(
        "rays",
        {},
        {"top": LidarStream("top", mount, times, made_up.Sweeps(sweep))},
        Trajectory(times, still),
        {"7": track},
    )


def cells(end: list[float], sweeps: int = 2, hits: np.ndarray | None = None) -> np.ndarray:
    log = log_of(np.array([end]), sweeps)
    return free_space(log, log.tracks["7"], np.zeros((0, 3)) if hits is None else hits).centres


def test_a_ray_to_what_lies_behind_empties_the_cells_on_its_way() -> None:
    found = cells([20.0, 0.0, 1.0])
    # Level at 1 m: all along the box, at that height, in one row of cells.
    height = 1.0 - CENTRE[2]
    assert np.ptp(found[:, 0]) > made_up.SIZE[0] - 0.2
    np.testing.assert_allclose(found[:, 2], height, atol=0.08)
    np.testing.assert_allclose(found[:, 1], 0.0, atol=0.08)


def test_what_a_ray_does_not_say() -> None:
    assert len(cells([10.0, 0.0, 1.0])) == 0  # ended in the box
    assert len(cells([12.6, 0.0, 1.0])) == 0  # or close behind it
    assert len(cells([20.0, 0.0, 1.0], sweeps=1)) == 0  # one ray alone
    assert len(cells([20.0, 8.0, 1.0])) == 0  # beside the box
    assert len(cells([-20.0, 0.0, 1.0])) == 0  # the other way


def test_near_a_hit_nothing_is_free() -> None:
    hits = np.array([[0.0, 0.0, 1.0 - CENTRE[2]]])
    found = cells([20.0, 0.0, 1.0], hits=hits)
    assert 0 < len(found) < len(cells([20.0, 0.0, 1.0]))
    assert np.linalg.norm(found - hits, axis=1).min() > 0.12


def test_points_in_free_cells() -> None:
    log = log_of(np.array([[20.0, 0.0, 1.0]]), 2)
    space = free_space(log, log.tracks["7"], np.zeros((0, 3)))
    height = 1.0 - CENTRE[2]
    np.testing.assert_array_equal(
        space.holds([[0.0, 0.0, height], [0.0, 0.5, height], [0.0, 0.0, -0.5]]),
        [True, False, False],
    )
