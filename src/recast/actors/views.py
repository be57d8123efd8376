"""All frames that may show a track: their scores, and the best of them, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from recast.actors.observation import ViewScore
from recast.arrays import Array
from recast.cameras import box_rectangle
from recast.core.errors import InputError
from recast.geometry import boxes, se3
from recast.logs import CameraStream, DrivingLog, LidarSweep, Track

_BOX_MARGIN = 0.05  # labels are often a little small: a share of the box's extent in the image
_OCCLUDER_GAP = 0.4  # metres before the box from which a LiDAR return counts as in front of it
Usable = Callable[[str, int], bool]
"""Whether a frame may be looked at, by camera name and index; held-out frames may not."""

LEAST_TURN = np.radians(15.0)
"""Angle between the azimuths of two views of one track, at least."""
_FULL_TURN = np.radians(90.0)  # a view turned that much shows another side
_LEAST_SHARE = 0.2  # of the best view's detail: smaller or more hidden ones tell too little
_LEAST_GAIN = 0.1  # of the best view's detail
_LEAST_IN_IMAGE = 1 / 3  # of the box: of less, neither the place nor the mask can be told
_MIN_CHECKED = 4
_SWEEP_REACH_US = 150_000


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
    rectangle = box_rectangle(track.size, camera_from_object, camera)
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
    """Which segments eye-target (N, 3) meet a box."""
    box_from_world = se3.inverse(world_from_box)
    start = se3.apply(box_from_world, eye[None])[0]
    step = se3.apply(box_from_world, targets) - start
    enter, leave = crossing(start, step, -size / 2, size / 2)
    return (enter < leave) & (leave > 0) & (enter < 1)


def crossing(start: Array, step: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Shares t (N,) at which lines start + t step (N, 3) enter and leave the box low to high (3,).

    They are clipped against the box's three slabs: lines that miss it leave before they enter.
    """
    step = np.where(np.abs(step) < 1e-9, 1e-9, step)
    first, last = (low - start) / step, (high - start) / step
    return np.minimum(first, last).max(axis=1), np.maximum(first, last).min(axis=1)


class NearestSweeps:
    """The LiDAR sweep nearest to a time; remembers the last one, since decoding takes a while."""

    def __init__(self, log: DrivingLog) -> None:
        self._log = log
        self._last: tuple[str, int, LidarSweep] | None = None

    def at(self, time: int) -> LidarSweep | None:
        """The nearest sweep, or None where none lies within 0.15 s."""
        found = [
            (int(gaps.min()), lidar.name, int(gaps.argmin()))
            for lidar in self._log.lidars.values()
            if len(gaps := np.abs(lidar.timestamps_us - time))
        ]
        gap, name, index = min(found, key=lambda one: one[0], default=(_SWEEP_REACH_US + 1, "", 0))
        if gap > _SWEEP_REACH_US:
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
    rectangle = box_rectangle(track.size, camera_from_object, stream.camera)
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


class ViewPool:
    """The frames in which a track is in view, with their scores.

    LiDAR occlusion can only lower a score. So it is checked from the top of a list down, until no
    frame left could win.

    Args:
        cameras: consider only these camera streams; all if none is named.
        usable: consider only these frames; all if None.

    Raises:
        InputError: the log has no such camera.
    """

    def __init__(
        self,
        log: DrivingLog,
        track: Track,
        cameras: Sequence[str] = (),
        usable: Usable | None = None,
    ) -> None:
        for camera in cameras:
            if camera not in log.cameras:
                names = ", ".join(log.cameras)
                raise InputError(
                    log.name, f"camera {camera}", "is not in the log", f"choose from {names}"
                )
        self._log, self._track, self._sweeps = log, track, NearestSweeps(log)
        self._checked: dict[tuple[str, int], ViewScore] = {}
        self._bounds = [
            score
            for name, stream in log.cameras.items()
            if not cameras or name in cameras
            for frame in range(len(stream.timestamps_us))
            if (usable is None or usable(name, frame))
            and (score := score_frame(log, track, stream, frame)) is not None
        ]

    def ranked(self) -> list[ViewScore]:
        """The best frames, best first, at least four if there are so many; ties: earlier first."""
        return self._best(lambda view: view.score, _MIN_CHECKED)

    def next_best(
        self, taken: Sequence[ViewScore], left_out: Sequence[ViewScore]
    ) -> ViewScore | None:
        """The frame that adds most to those taken: by its detail times the turn to the nearest one.

        The turn counts in full from 90 degrees of azimuth on, and not at all below `LEAST_TURN`.
        None if no frame is left that adds a tenth of what the first view tells.

        Args:
            taken: views so far, best first; at least one.
            left_out: views that turned out to be unusable.
        """
        first = taken[0].detail
        refused = {view.key for view in left_out}

        def gain(view: ViewScore) -> float:
            turn = min(_turn(view, other) for other in taken)
            adds = view.detail * min(turn / _FULL_TURN, 1.0)
            enough = turn >= LEAST_TURN and adds >= _LEAST_GAIN * first
            whole = view.in_image >= _LEAST_IN_IMAGE and view.detail >= _LEAST_SHARE * first
            return adds if enough and whole and view.key not in refused else 0.0

        best = self._best(gain, 1)
        return best[0] if best else None

    def _best(self, value: Callable[[ViewScore], float], count: int) -> list[ViewScore]:
        """The frames checked on the way to the most valuable one, that first."""
        checked: list[tuple[float, ViewScore]] = []
        bounds = [(value(bound), bound) for bound in self._bounds]
        for limit, bound in sorted(bounds, key=lambda one: -one[0]):
            best = max((found for found, _ in checked), default=0.0)
            if limit <= 0 or (len(checked) >= count and best >= limit):
                break
            score = self._check(bound)
            if (found := value(score)) > 0:
                checked.append((found, score))
        return [score for _, score in sorted(checked, key=lambda one: -one[0])]

    def _check(self, bound: ViewScore) -> ViewScore:
        if bound.key not in self._checked:
            self._checked[bound.key] = check_lidar(self._log, self._track, bound, self._sweeps)
        return self._checked[bound.key]


def _turn(first: ViewScore, second: ViewScore) -> float:
    """Angle between the azimuths of two views, radians in [0, pi]."""
    apart = first.azimuth - second.azimuth
    return float(abs(np.arctan2(np.sin(apart), np.cos(apart))))
