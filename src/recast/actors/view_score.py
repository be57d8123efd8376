"""Score every frame in which a track might be seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from recast.actors.observation import ViewScore
from recast.geometry import boxes, se3
from recast.logs import CameraStream, DrivingLog, LidarSweep, Track

Array = NDArray[np.float64]

_BOX_MARGIN = 0.05  # labels are often a little small: a share of the box's extent in the image
_OCCLUDER_GAP = 0.4  # metres before the box from which a LiDAR return counts as in front of it


def score_frame(
    log: DrivingLog, track: Track, stream: CameraStream, frame: int
) -> ViewScore | None:
    """Terms of one frame but for `unblocked`, which stays 1 until `check_lidar`.

    None where the track is not there or not in view.
    """
    time = int(stream.timestamps_us[frame])
    if not track.trajectory.covers(time):
        return None
    camera_from_world = se3.inverse(log.world_from_rig.at(time) @ stream.rig_from_camera)
    camera_from_object = camera_from_world @ track.trajectory.at(time)
    eye = se3.inverse(camera_from_object)[:3, 3]
    if camera_from_object[2, 3] < 0.5 * track.size[0]:  # beside or behind the camera
        return None
    camera = stream.camera.rectified()
    rectangle = boxes.project(track.size, camera_from_object, camera)
    if rectangle is None:
        return None
    grow = _BOX_MARGIN * (rectangle[2:] - rectangle[:2])
    left, top, right, bottom = np.concatenate([rectangle[:2] - grow, rectangle[2:] + grow])
    width = min(right, camera.width) - max(left, 0.0)
    height = min(bottom, camera.height) - max(top, 0.0)
    if width <= 0 or height <= 0:
        return None
    inside = width * height
    return ViewScore(
        camera=stream.name,
        frame=frame,
        timestamp_us=time,
        size_px=float(np.sqrt(inside)),
        in_image=float(inside / ((right - left) * (bottom - top))),
        unoccluded=_unoccluded(log, track, time, camera_from_world),
        unblocked=1.0,
        azimuth=float(np.arctan2(eye[1], eye[0])),
    )


def _unoccluded(log: DrivingLog, track: Track, time: int, camera_from_world: Array) -> float:
    """Share of points of the track's box whose line of sight misses the other tracks' boxes."""
    targets = boxes.lattice(track.size, track.trajectory.at(time))
    eye = se3.inverse(camera_from_world)[:3, 3]
    hidden = np.zeros(len(targets), bool)
    for other in log.tracks.values():
        if other.track_id != track.track_id and other.trajectory.covers(time):
            hidden |= _crosses_box(eye, targets, other.size, other.trajectory.at(time))
    return float(1 - hidden.mean())


def _crosses_box(
    eye: Array, targets: Array, size: Array, world_from_box: Array
) -> NDArray[np.bool_]:
    """Which segments eye-target (N, 3) meet a box, by clipping them against its three slabs."""
    box_from_world = se3.inverse(world_from_box)
    start = se3.apply(box_from_world, eye[None])[0]
    step = se3.apply(box_from_world, targets) - start
    step = np.where(np.abs(step) < 1e-9, 1e-9, step)
    first, last = (-size / 2 - start) / step, (size / 2 - start) / step
    enter = np.minimum(first, last).max(axis=1)
    leave = np.maximum(first, last).min(axis=1)
    crossing: NDArray[np.bool_] = (enter < leave) & (leave > 0) & (enter < 1)
    return crossing


class NearestSweeps:
    """The LiDAR sweep nearest to a time; remembers the last one, since decoding takes a while."""

    def __init__(self, log: DrivingLog, within_us: int = 150_000) -> None:
        self._log = log
        self._within_us = within_us
        self._last: tuple[str, int, LidarSweep] | None = None

    def at(self, time: int) -> LidarSweep | None:
        """The nearest sweep, or None where none lies within the limit."""
        name, index, least = "", -1, self._within_us + 1
        for lidar in self._log.lidars.values():
            if len(lidar.timestamps_us) == 0:
                continue
            i = int(np.argmin(np.abs(lidar.timestamps_us - time)))
            gap = abs(int(lidar.timestamps_us[i]) - time)
            if gap < least:
                name, index, least = lidar.name, i, gap
        if index < 0:
            return None
        if self._last is None or self._last[:2] != (name, index):
            self._last = (name, index, self._log.lidars[name].sweeps[index])
        return self._last[2]


def check_lidar(
    log: DrivingLog, track: Track, score: ViewScore, sweeps: NearestSweeps
) -> ViewScore:
    """The score with `unblocked` filled in: one minus the share of LiDAR returns inside the box's
    rectangle that are nearer than the box.
    """
    time = score.timestamp_us
    stream = log.cameras[score.camera]
    sweep = sweeps.at(time)
    camera_from_world = se3.inverse(log.world_from_rig.at(time) @ stream.rig_from_camera)
    camera_from_object = camera_from_world @ track.trajectory.at(time)
    rectangle = boxes.project(track.size, camera_from_object, stream.camera)
    if sweep is None or rectangle is None:
        return score
    world = se3.apply(log.world_from_rig.at(sweep.timestamp_us), sweep.points)
    points = se3.apply(camera_from_world, world)
    points = points[points[:, 2] > 0.5]
    pixels, depth = stream.camera.rectified().project(points)
    pad = 0.15 * (rectangle[2:] - rectangle[:2])
    aimed = np.all((pixels > rectangle[:2] + pad) & (pixels < rectangle[2:] - pad), axis=1)
    box = boxes.corners(track.size, camera_from_object)
    # the near side of the box along each line of sight is at least as far as its nearest corner
    in_front = aimed & (depth < box[:, 2].min() - _OCCLUDER_GAP)
    unblocked = float(1 - in_front.sum() / max(int(aimed.sum()), 1))
    return replace(score, unblocked=unblocked)
