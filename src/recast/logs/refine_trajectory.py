"""Sharper ego trajectories: GPS/IMU poses corrected by matching LiDAR sweeps.

GPS/IMU poses are good over minutes, but wander by decimetres within seconds, which blurs whatever
is gathered over several frames. LiDAR sweeps matched one to the next are good to a centimetre over
seconds, but drift over minutes. A small pose graph takes the best of both. Roll and pitch stay with
the IMU, which feels gravity; scanners see roads bent by errors of their own elevation angles.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from recast.geometry import se3
from recast.logs.scan_matching import Surfels, adjoint, match, surfels, thin
from recast.logs.types import Array, LidarStream, Trajectory

MAP_SWEEPS = 8
STEP_SIGMA = np.array([0.01, 0.01, 0.01, 3e-4, 3e-4, 3e-4])  # metres, radians: sweep to sweep
PLACE_SIGMA = np.array([0.5, 0.5, 0.5, 5e-4, 5e-4, 0.02])  # metres, radians: GPS/IMU
ITERATIONS = 5


def refine_trajectory(lidar: LidarStream, world_from_rig: Trajectory) -> Trajectory:
    """Correct an ego trajectory by the sweeps of a LiDAR.

    The correction is found at the sweeps, interpolated between them and held beyond them, so the
    trajectory keeps its timestamps and its fine motion.

    Args:
        lidar: sweeps in the rig frame.
        world_from_rig: covers the sweeps.
    """
    if len(lidar.timestamps_us) < 2:
        return world_from_rig
    recorded = world_from_rig.at(lidar.timestamps_us)
    matched = _match_in_turn(lidar, recorded)
    steps = se3.inverse(matched[:-1]) @ matched[1:]
    refined = _pose_graph(recorded, steps)
    correction = se3.inverse(recorded) @ refined
    times = lidar.timestamps_us
    held = np.clip(world_from_rig.timestamps_us, times[0], times[-1])
    poses = world_from_rig.poses @ se3.interpolate(times, correction, held)
    return Trajectory(world_from_rig.timestamps_us, poses)


def _match_in_turn(lidar: LidarStream, recorded: Array) -> Array:
    """Poses (S, 4, 4) of the sweeps, each matched to a map of those before it."""
    poses = [recorded[0]]
    recent: deque[Surfels] = deque(maxlen=MAP_SWEEPS)
    for index in range(len(lidar.timestamps_us)):
        sweep = lidar.sweeps[index].points.astype(np.float64)
        points = thin(sweep)
        if index:
            guess = poses[-1] @ se3.inverse(recorded[index - 1]) @ recorded[index]
            world = Surfels(
                np.concatenate([part.points for part in recent]),
                np.concatenate([part.normals for part in recent]),
            )
            poses.append(match(points, world, guess))
        recent.append(surfels(sweep, points).moved(poses[-1]))
    return np.array(poses)


def _pose_graph(recorded: Array, steps: Array) -> Array:
    """Poses (S, 4, 4) that honour the matched steps (S-1, 4, 4) and stay near the recorded ones.

    Gauss-Newton on twists, perturbing on the right: a step's residual log(Z^-1 X_i^-1 X_j) changes
    by d_j - Ad(X_j^-1 X_i) d_i, a place's log(P^-1 X) by d.
    """
    count = len(recorded)
    poses = [recorded[0]]
    for step in steps:
        poses.append(poses[-1] @ step)
    x = np.array(poses)
    row_weight = np.concatenate(
        [np.tile(1 / STEP_SIGMA, count - 1), np.tile(1 / PLACE_SIGMA, count)]
    )
    places = sparse.identity(6 * count, format="csr")
    for _ in range(ITERATIONS):
        relative = se3.inverse(x[:-1]) @ x[1:]
        back = -adjoint(se3.inverse(relative))
        blocks = sparse.bsr_matrix(
            (back, np.arange(count - 1), np.arange(count)), shape=(6 * (count - 1), 6 * count)
        )
        ahead = sparse.eye(6 * (count - 1), 6 * count, k=6)
        jacobian = sparse.vstack([blocks + ahead, places]).tocsr()
        residual = np.concatenate(
            [
                se3.log(se3.inverse(steps) @ relative).ravel(),
                se3.log(se3.inverse(recorded) @ x).ravel(),
            ]
        )
        weighted = sparse.diags(row_weight**2)
        normal = (jacobian.T @ weighted @ jacobian).tocsc()
        change = -spsolve(normal, jacobian.T @ (weighted @ residual))
        x = x @ se3.exp(change.reshape(count, 6))
    return x


def heading_offset(trajectory: Trajectory, slowest: float = 3.0) -> float:
    """Angle in radians from the rig's x axis to its motion: the median over the drive.

    The rear axle does not slip sideways on a road, so the angle is the error of the mounting's
    yaw. Only what is faster than `slowest` m/s counts; 0.0 where nothing is.
    """
    seconds = np.diff(trajectory.timestamps_us) / 1e6
    step = se3.inverse(trajectory.poses[:-1]) @ trajectory.poses[1:]
    moved = step[:, :2, 3]
    # Seen from the first pose a circular arc ends half its turn off the start's heading.
    angle = np.arctan2(moved[:, 1], moved[:, 0]) - se3.yaw(step) / 2
    fast = np.linalg.norm(moved, axis=1) > slowest * seconds
    return float(np.median(angle[fast])) if np.any(fast) else 0.0
