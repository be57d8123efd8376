"""LiDAR for reconstruction: sweeps split by owner, and sparse depth maps of the views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.geometry import se3
from recast.logs import DrivingLog, LidarSweep, Track
from recast.scene.dynamic import pose_at
from recast.scene.views import View

Float32Array = NDArray[np.float32]
Array = NDArray[np.float64]

MARGIN_M = 0.15
GROUND_M = 0.1


@dataclass(frozen=True)
class OwnedSweep:
    """A sweep divided by what its points lie on.

    Attributes:
        timestamp_us: time of the sweep.
        background: (N, 3) float32, world frame. The ground at a moving object's feet is in neither
            part: its shadow darkens it.
        actors: (M, 3) float32 by track id, actor-local frame.
    """

    timestamp_us: int
    background: Float32Array
    actors: Mapping[str, Float32Array]


@dataclass(frozen=True)
class DepthSamples:
    """LiDAR depth of one view.

    Attributes:
        depths: (M,) float32 metres along the camera's z axis.
        uv: (M, 2) float32 pixel coordinates, inside the image.
    """

    depths: Float32Array
    uv: Float32Array


def read_sweeps(
    log: DrivingLog, actors: Mapping[str, Track], held_out_us: Sequence[int], skip_us: int = 20_000
) -> list[OwnedSweep]:
    """All sweeps but those taken together with a held-out image (within `skip_us`)."""
    sweeps = []
    held_out = np.asarray(held_out_us, np.int64)
    for stream in log.lidars.values():
        for index, timestamp in enumerate(stream.timestamps_us.tolist()):
            if held_out.size and np.min(np.abs(held_out - timestamp)) < skip_us:
                continue
            sweeps.append(_divide(stream.sweeps[index], log.world_from_rig.at(timestamp), actors))
    return sorted(sweeps, key=lambda sweep: sweep.timestamp_us)


def _divide(sweep: LidarSweep, world_from_rig: Array, actors: Mapping[str, Track]) -> OwnedSweep:
    world = se3.apply(world_from_rig, sweep.points)
    free = np.ones(len(world), bool)
    local_points = {}
    for track_id, track in actors.items():
        rough = pose_at(track.trajectory, sweep.timestamp_us)
        if rough is None:
            continue
        reach = np.linalg.norm(track.size) / 2 + 2.5
        near = np.flatnonzero(np.linalg.norm(world - rough[:3, 3], axis=1) < reach)
        if len(near) == 0:
            continue
        pose = rough
        if sweep.point_timestamps_us is not None:
            # The laser crosses an object within a few milliseconds: one pose serves all its points.
            moment = int(np.median(sweep.point_timestamps_us[near]))
            exact = pose_at(track.trajectory, moment)
            pose = rough if exact is None else exact
        local = se3.apply(se3.inverse(pose), world[near])
        half = track.size / 2
        inside = np.all(np.abs(local) <= half + MARGIN_M, axis=1)
        free[near[inside]] = False
        above = local[:, 2] >= GROUND_M - half[2]
        local_points[track_id] = local[inside & above].astype(np.float32)
    return OwnedSweep(sweep.timestamp_us, world[free].astype(np.float32), local_points)


def depth_samples(
    view: View,
    sweeps: Sequence[OwnedSweep],
    actors: Mapping[str, Track],
    *,
    window_us: int = 350_000,
    near: float = 1.0,
    far: float = 100.0,
) -> DepthSamples:
    """Depths of one view from the sweeps around its time, moving objects carried along.

    Background points are taken where they lie in the world; points of an actor are moved with its
    box from the sweep's time to the view's. Points hidden behind nearer ones are dropped (the
    sweeps were taken from other places than the view).
    """
    clouds = []
    for sweep in sweeps:
        if abs(sweep.timestamp_us - view.timestamp_us) > window_us:
            continue
        clouds.append(sweep.background)
        for track_id, local in sweep.actors.items():
            pose = pose_at(actors[track_id].trajectory, view.timestamp_us)
            if pose is not None:
                clouds.append(se3.apply(pose, local).astype(np.float32))
    if not clouds:
        clouds.append(np.zeros((0, 3), np.float32))
    _, uv, depth = project_visible(np.concatenate(clouds), view, near=near, far=far)
    return DepthSamples(depth, uv)


def project_visible(
    points: Float32Array, view: View, *, near: float = 1.0, far: float = 100.0, reach: int = 3
) -> tuple[NDArray[np.int64], Float32Array, Float32Array]:
    """Points (N, 3) of the world that a view sees: (index, uv (M, 2), depth (M,)).

    A point counts as hidden where a point in the (2 reach + 1)^2 pixels around it is nearer by more
    than 5 % and 0.3 m.
    """
    camera = view.camera
    camera_from_world = view.camera_from_world.astype(np.float32)
    local = points @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
    index = np.flatnonzero((local[:, 2] > near) & (local[:, 2] < far))
    local = local[index]
    u = local[:, 0] / local[:, 2] * np.float32(camera.fx) + np.float32(camera.cx)
    v = local[:, 1] / local[:, 2] * np.float32(camera.fy) + np.float32(camera.cy)
    inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    index, u, v, depth = index[inside], u[inside], v[inside], local[inside, 2]
    buffer = np.full((camera.height, camera.width), far, np.float32)
    rows, columns = v.astype(np.int64), u.astype(np.int64)
    np.minimum.at(buffer, (rows, columns), depth)
    nearest = cv2.erode(buffer, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))[rows, columns]
    seen = depth < np.maximum(1.05 * nearest, nearest + 0.3)
    return index[seen], np.stack([u, v], -1)[seen], depth[seen]
