"""Motion between measurements: LiDAR points in one frame, and ego poses sharpened by LiDAR.

GPS/IMU poses are good over minutes, but wander by decimetres within seconds, which blurs whatever
is gathered over several frames. LiDAR sweeps matched one to the next are good to a centimetre over
seconds, but drift over minutes. A small pose graph takes the best of both. Roll and pitch stay with
the IMU, which feels gravity; scanners see roads bent by errors of their own elevation angles.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree

from recast.geometry import se3
from recast.logs.types import (
    Array,
    DrivingLog,
    Float32Array,
    Int64Array,
    LidarStream,
    LidarSweep,
    Track,
    Trajectory,
)

MAX_EXTENSION_US = 150_000
NEAREST_LABEL_US = 160_000  # a sweep farther from every label tells nothing certain
LONGEST_TABLE_US = 1_000_000  # a turn of a scanner has a tenth


def compensate(
    points: Array, timestamps_us: Int64Array, world_from_rig: Trajectory, reference_us: int
) -> Array:
    """Points (N, 3) of the rig frames at `timestamps_us` (N,), in the rig frame at `reference_us`.
    Raises ValueError: a time lies outside the trajectory."""
    times, index = distinct_times(timestamps_us)
    moved = se3.inverse(world_from_rig.at(reference_us)) @ world_from_rig.at(times)
    return _apply_each(moved, index, points)


def distort(
    points: Array, timestamps_us: Int64Array, world_from_rig: Trajectory, reference_us: int
) -> Array:
    """Inverse of `compensate`: from the rig frame at `reference_us` to those at `timestamps_us`."""
    times, index = distinct_times(timestamps_us)
    moved = se3.inverse(world_from_rig.at(times)) @ world_from_rig.at(reference_us)
    return _apply_each(moved, index, points)


def distinct_times(timestamps_us: Int64Array) -> tuple[Int64Array, Int64Array]:
    """What `np.unique` gives with `return_inverse`: times (T,) in order, and each one's place (N,).

    The points of a sweep share few times within a tenth of a second, so a table of microseconds
    finds them without sorting.
    """
    if len(timestamps_us) == 0:
        return np.unique(timestamps_us, return_inverse=True)
    first = timestamps_us.min()
    span = int(timestamps_us.max()) - int(first) + 1
    if span > max(LONGEST_TABLE_US, len(timestamps_us)):
        return np.unique(timestamps_us, return_inverse=True)
    offsets = timestamps_us - first
    table = np.zeros(span, bool)
    table[offsets] = True
    places: Int64Array = np.cumsum(table, dtype=np.int64) - 1
    return first + np.flatnonzero(table), places[offsets]


def _apply_each(transforms: Array, index: Int64Array, points: Array) -> Array:
    chosen = np.take(transforms[:, :3].reshape(-1, 12), index, axis=0).reshape(-1, 3, 4)
    points = np.asarray(points, np.float64)
    return np.einsum("nij,nj->ni", chosen[:, :, :3], points) + chosen[:, :, 3]


def extended(trajectory: Trajectory, first_us: int, last_us: int) -> Trajectory:
    """Lengthen a trajectory to cover [first_us, last_us], by at most 0.15 s at either end.

    Sensors start and stop within a cycle of each other, so the first image may come before the
    first pose. The motion of the first (last) interval is continued with a constant twist; a
    single pose is held.
    """
    times, poses = trajectory.timestamps_us, trajectory.poses
    if len(times) == 1:
        times, poses = np.append(times, times[0] + 1), np.concatenate([poses, poses])
    first = max(first_us, int(times[0]) - MAX_EXTENSION_US)
    last = min(last_us, int(times[-1]) + MAX_EXTENSION_US)
    new_times: Int64Array = times
    new_poses = poses
    if first < times[0]:
        start = _continued(poses[1], poses[0], times[0] - times[1], first - times[0])
        new_times = np.concatenate([[first], new_times])
        new_poses = np.concatenate([start[None], new_poses])
    if last > times[-1]:
        end = _continued(poses[-2], poses[-1], times[-1] - times[-2], last - times[-1])
        new_times = np.concatenate([new_times, [last]])
        new_poses = np.concatenate([new_poses, end[None]])
    return Trajectory(new_times.astype(np.int64), new_poses)


def _continued(before: Array, at: Array, interval_us: int, ahead_us: int) -> Array:
    twist = se3.log(se3.inverse(before) @ at)
    return at @ se3.exp(twist * (ahead_us / interval_us))


def logged_velocity(trajectory: Trajectory, timestamps_us: Int64Array | int, step_us: int) -> Array:
    """Velocities (..., 2) in the world, m/s, at times (...) within a trajectory.

    Differences over `step_us` to each side, less at its ends.
    """
    ends = trajectory.timestamps_us[[0, -1]]
    around = np.clip([timestamps_us - step_us, timestamps_us + step_us], *ends)
    before, after = trajectory.at(around)[..., :2, 3]
    seconds: Array = np.maximum((around[1] - around[0]) * 1e-6, 1e-6)
    return (after - before) / seconds[..., None]


class TrackPoints(NamedTuple):
    """Points on one object.

    Attributes:
        points: (N, 3) float32 metres, actor-local frame.
        sweep: (N,) int32, index of the sweep, counted through all LiDARs in the log's order.
        intensity: (N,) float32.
    """

    points: Float32Array
    sweep: NDArray[np.int32]
    intensity: Float32Array


def track_points(
    log: DrivingLog, track: Track, margin: float = 0.15, clearance: float = 0.1
) -> TrackPoints:
    """LiDAR points inside a track's box over all sweeps, in the actor-local frame.

    Every point is put into the box as it stood when the point was measured, so moving objects
    come out sharp.

    Args:
        margin: metres by which sides and top are moved outwards; labelled boxes are often that
            much too tight.
        clearance: metres by which the bottom is raised, to leave the road out.
    """
    return all_track_points(log, {track.track_id: track}, margin, clearance)[track.track_id]


def all_track_points(
    log: DrivingLog, tracks: Mapping[str, Track], margin: float = 0.15, clearance: float = 0.1
) -> dict[str, TrackPoints]:
    """`track_points` of many tracks; reads every sweep once."""
    found: dict[str, list[TrackPoints]] = {name: [_NOTHING] for name in tracks}
    count = 0
    for lidar in log.lidars.values():
        for index, time in enumerate(lidar.timestamps_us.tolist()):
            labelled = {
                name: track
                for name, track in tracks.items()
                if np.abs(track.trajectory.timestamps_us - time).min() <= NEAREST_LABEL_US
            }
            if not labelled:
                continue
            sweep = lidar.sweeps[index]
            for name, track in labelled.items():
                local, intensity = _in_actor(log, track, sweep, margin)
                high = track.size / 2 + margin
                low = -high
                low[2] = -track.size[2] / 2 + clearance
                inside = np.all((local >= low) & (local <= high), axis=1)
                number = np.full(np.count_nonzero(inside), count + index, np.int32)
                found[name].append(
                    TrackPoints(local[inside].astype(np.float32), number, intensity[inside])
                )
        count += len(lidar.timestamps_us)
    return {name: _joined(parts) for name, parts in found.items()}


_NOTHING = TrackPoints(np.zeros((0, 3), np.float32), np.zeros(0, np.int32), np.zeros(0, np.float32))


def _joined(parts: list[TrackPoints]) -> TrackPoints:
    return TrackPoints(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _in_actor(
    log: DrivingLog, track: Track, sweep: LidarSweep, margin: float
) -> tuple[Array, Float32Array]:
    """Points (N, 3) near the object in its frame, and their intensities (N,)."""
    labelled = track.trajectory.timestamps_us[[0, -1]]
    pose = track.trajectory.at(np.clip(sweep.timestamp_us, *labelled))
    world_from_rig = log.world_from_rig.at(sweep.timestamp_us)
    centre = se3.apply(se3.inverse(world_from_rig), pose[None, :3, 3])[0]
    # A car at 50 m/s moves 2.5 m in half a turn: enough to meet points at the edge of the sweep.
    reach = float(np.linalg.norm(track.size)) / 2 + margin + 2.5
    near = _within(sweep.points, centre, reach)
    points = se3.apply(world_from_rig, sweep.points[near])
    if sweep.point_timestamps_us is None:
        return se3.apply(se3.inverse(pose), points), sweep.intensity[near]
    # Labels begin and end within a turn of the sweep: hold the box there, it moves centimetres.
    times = np.clip(sweep.point_timestamps_us[near], *labelled)
    moments, index = distinct_times(times)
    actor_from_world = se3.inverse(track.trajectory.at(moments))
    return _apply_each(actor_from_world, index, points), sweep.intensity[near]


def _within(points: Float32Array, centre: Array, reach: float) -> NDArray[np.intp]:
    """Indices of the points (N, 3) nearer than `reach` to `centre`.

    Along x the most fall out, at a tenth of the cost of a distance.
    """
    beside = np.flatnonzero(np.abs(points[:, 0] - centre[0]) < reach)
    return beside[np.linalg.norm(points[beside] - centre, axis=1) < reach]


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
