"""Sharper ego trajectories: GPS/IMU poses corrected by matching LiDAR sweeps.

GPS/IMU poses are good over minutes, but wander by decimetres within seconds, which blurs whatever
is gathered over several frames. LiDAR sweeps matched one to the next are good to a centimetre over
seconds, but drift over minutes. A small pose graph takes the best of both. Roll and pitch stay with
the IMU, which feels gravity; scanners see roads bent by errors of their own elevation angles.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree

from recast.geometry import se3
from recast.logs.types import Array, LidarStream, Trajectory

NEAREST, FARTHEST = 3.0, 50.0  # metres of a sweep that are used
VOXEL = 0.5  # metres between matched points
NEIGHBOURS = 12
FLATNESS = 0.04  # metres, standard deviation across a surface
EXTENT = 0.08  # metres, along it: below this, neighbours lie on one scan line
SIGMA = 0.05  # metres, scale of the robust weight
NOISE = 0.3
"""Metres: scale of one residual against the prior; neighbours' errors are not independent."""
PRIOR_SIGMA = np.array([0.05, 0.05, 0.03, 0.002, 0.002, 0.003])  # metres, radians: of the guess
GATES = (1.0, 0.6, 0.4, 0.3, 0.3, 0.3, 0.3, 0.3)  # metres to the nearest map point, by iteration
MAP_SWEEPS = 8
STEP_SIGMA = np.array([0.01, 0.01, 0.01, 3e-4, 3e-4, 3e-4])  # metres, radians: sweep to sweep
PLACE_SIGMA = np.array([0.5, 0.5, 0.5, 5e-4, 5e-4, 0.02])  # metres, radians: GPS/IMU
ITERATIONS = 5
SLOWEST = 3.0  # m/s, at which the heading of the motion is measured
LARGEST_OFFSET = np.radians(5.0)
"""Radians: largest error of a mounting's yaw. More is not a mounting's error, and is left to
`recast.logs.plausibility`."""


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


def heading_offset(trajectory: Trajectory) -> float:
    """Angle in radians from the rig's x axis to its motion: the median over the drive.

    The rear axle does not slip sideways on a road, so the angle is the error of the mounting's
    yaw; a car that reverses moves against its x axis. Only what is faster than 3 m/s counts; 0.0
    if nothing is, or if the angle is above `LARGEST_OFFSET`.
    """
    seconds = np.diff(trajectory.timestamps_us) / 1e6
    step = se3.inverse(trajectory.poses[:-1]) @ trajectory.poses[1:]
    moved = step[:, :2, 3]
    # Seen from the first pose a circular arc ends half its turn off the start's heading.
    angle = np.arctan2(moved[:, 1], moved[:, 0]) - se3.yaw(step) / 2
    folded = (angle + np.pi / 2) % np.pi - np.pi / 2
    fast = np.linalg.norm(moved, axis=1) > SLOWEST * seconds
    offset = float(np.median(folded[fast])) if np.any(fast) else 0.0
    return offset if abs(offset) <= LARGEST_OFFSET else 0.0


@dataclass(frozen=True)
class Surfels:
    """Points with the normals of the surface around them."""

    # points, normals: (N, 3).
    points: Array
    normals: Array

    def moved(self, target_from_source: Array) -> Surfels:
        """The same surfels in another frame."""
        return Surfels(
            se3.apply(target_from_source, self.points),
            self.normals @ target_from_source[:3, :3].T,
        )


def thin(points: Array) -> Array:
    """One point (M, 3) of each voxel of a sweep (N, 3), between the nearest and farthest range."""
    distance = np.linalg.norm(points[:, :2], axis=1)
    kept = points[(distance > NEAREST) & (distance < FARTHEST)].astype(np.float64)
    voxel = np.floor(kept / VOXEL).astype(np.int64)
    key = (voxel[:, 0] * 4096 + voxel[:, 1]) * 4096 + voxel[:, 2]
    _, first = np.unique(key, return_index=True)
    return kept[np.sort(first)]


def surfels(points: Array, at: Array) -> Surfels:
    """Surfels at points `at` (M, 3) of a sweep (N, 3), where the sweep is flat there."""
    if len(points) < NEIGHBOURS:
        return Surfels(np.zeros((0, 3)), np.zeros((0, 3)))
    tree = cKDTree(points)
    _, index = tree.query(at, k=NEIGHBOURS)
    around = points[index]
    centred = around - around.mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred) / NEIGHBOURS)
    flat = (spread[:, 0] < FLATNESS**2) & (spread[:, 1] > EXTENT**2)
    return Surfels(around.mean(axis=1)[flat], axes[flat, :, 0])


def match(points: Array, world: Surfels, guess: Array) -> Array:
    """Pose (4, 4) `world_from_sweep` of points (N, 3) against a map.

    Gauss-Newton on point-to-plane distances with Geman-McClure weights, held to the guess where
    the map says little: along a tunnel the guess stays.

    Args:
        guess: (4, 4) `world_from_sweep` to start from.
    """
    tree = cKDTree(world.points)
    pose = guess.copy()
    prior = np.diag(1.0 / PRIOR_SIGMA**2)
    for gate in GATES:
        moved = se3.apply(pose, points)
        distance, nearest = tree.query(moved, distance_upper_bound=gate)
        hit = np.isfinite(distance)
        local, normals = points[hit], world.normals[nearest[hit]] @ pose[:3, :3]
        residual = np.einsum(
            "ni,ni->n", moved[hit] - world.points[nearest[hit]], world.normals[nearest[hit]]
        )
        weight = 1.0 / (1.0 + (residual / SIGMA) ** 2) ** 2 / NOISE**2
        jacobian = np.concatenate([normals, np.cross(local, normals)], axis=1)
        off = se3.log(se3.inverse(guess) @ pose)
        hessian = (jacobian * weight[:, None]).T @ jacobian + prior
        gradient = (jacobian * weight[:, None]).T @ residual + prior @ off
        step = -np.linalg.solve(hessian, gradient)
        pose = pose @ se3.exp(step)
        if np.linalg.norm(step) < 1e-5 and gate == GATES[-1]:
            break
    return pose


def adjoint(matrix: Array) -> NDArray[np.float64]:
    """Adjoints (..., 6, 6) of transforms (..., 4, 4), twists ordered as in `se3.exp`."""
    rotation, translation = matrix[..., :3, :3], matrix[..., :3, 3]
    skew = np.zeros_like(rotation)
    skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0] = np.moveaxis(translation, -1, 0)
    skew[..., 1, 2], skew[..., 2, 0], skew[..., 0, 1] = np.moveaxis(-translation, -1, 0)
    result = np.zeros((*matrix.shape[:-2], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = rotation
    result[..., :3, 3:] = skew @ rotation
    return result
