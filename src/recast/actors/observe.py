"""Pick the best view of a track and cut it out; or take a single picture with a known camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.actors.observation import (
    NearestSweeps,
    Observation,
    Usable,
    ViewPool,
    ViewScore,
    crossing,
)
from recast.actors.segment import (
    SegmentationTarget,
    Segmenter,
    mask_quality,
    mask_rectangle,
    run_segmenter,
)
from recast.arrays import Array
from recast.cameras import PinholeCamera, box_rectangle
from recast.cameras.pinhole import distort
from recast.core.errors import InputError
from recast.geometry import boxes, se3
from recast.logs import CameraStream, DrivingLog, Track, track_points

MIN_LIDAR_POINTS = 20
_CROP_MARGIN = 0.18  # share of the longer side of box or mask left around it
_BOX_GROWTH = 0.12  # metres around the label within which a return belongs to the vehicle


def observe(
    log: DrivingLog,
    track_id: str,
    *,
    segmenter: Segmenter,
    cameras: Sequence[str] = (),
    views: int = 1,
    usable: Usable | None = None,
) -> Observation:
    """The best view of a track: largest, least truncated and occluded.

    Further views show other sides. One whose mask contradicts box or LiDAR is passed over.

    Args:
        cameras: consider only these camera streams; all where none is named.
        views: how many views to take at most; those after the best are its `further`.
        usable: tells which frames may be looked at; all if None.

    Raises:
        InputError: no such track or camera, a track that is never visible, or one with fewer than
            20 LiDAR points.
        ValueError: `views` below 1.
    """
    if views < 1:
        raise ValueError(f"observe: views {views}, expected at least 1")
    track = track_of(log, track_id)
    points = track_points(log, track).points
    require_points(points, log, track_id)
    pool = ViewPool(log, track, cameras, usable)
    candidates = pool.ranked()
    if not candidates:
        raise InputError(
            log.name,
            f"track {track_id}",
            "is never visible in " + (" or ".join(cameras) or "any camera"),
            "choose another track or camera: recast log info lists them",
        )

    def cut(view: ViewScore) -> Observation:
        target = _cut(log, track, log.cameras[view.camera], view, np.asarray(points, np.float64))
        found = run_segmenter(segmenter, target)
        return Observation(
            track_id=track_id,
            category=track.category,
            size=np.asarray(track.size, np.float64),
            rgba=np.dstack([target.image, found.alpha]),
            camera=target.camera,
            camera_from_object=target.camera_from_object,
            points=points,
            view=view,
            candidates=tuple(candidates),
            mask_quality=mask_quality(target, found),
        )

    first = cut(candidates[0])
    further: list[Observation] = []
    left_out: list[ViewScore] = []
    while len(further) + 1 < views:
        view = pool.next_best([first.view, *(one.view for one in further)], left_out)
        if view is None:
            break
        one = cut(view)
        if one.mask_quality.agrees:
            further.append(one)
        else:
            left_out.append(view)
    return replace(first, further=tuple(further))


def require_points(points: NDArray[np.float32], log: DrivingLog, track_id: str) -> None:
    """Refuse a track whose LiDAR points (N, 3) are too few to place a vehicle by. Raises
    InputError: fewer than 20."""
    if len(points) < MIN_LIDAR_POINTS:
        raise InputError(
            log.name,
            f"track {track_id}",
            f"has {len(points)} LiDAR points in its boxes, at least {MIN_LIDAR_POINTS} are needed",
            "choose a track that comes nearer: recast log info lists them",
        )


def track_of(log: DrivingLog, track_id: str) -> Track:
    """A track by its id; raises InputError if there is none."""
    if track_id not in log.tracks:
        known = ", ".join(sorted(log.tracks, key=lambda k: (len(k), k)))
        raise InputError(
            log.name, f"track {track_id}", "is not in the log", f"choose one of: {known}"
        )
    return log.tracks[track_id]


def _cut(
    log: DrivingLog, track: Track, stream: CameraStream, view: ViewScore, object_points: Array
) -> SegmentationTarget:
    """The crop around the track in one frame with the LiDAR evidence for its mask."""
    time = view.timestamp_us
    camera_from_world = se3.inverse(log.world_from_rig.at(time) @ stream.rig_from_camera)
    camera_from_object = camera_from_world @ track.trajectory.at(time)
    rectangle = box_rectangle(track.size, camera_from_object, stream.camera)
    assert rectangle is not None  # scored frames show the box
    crop = _crop_window(stream.camera, rectangle)
    camera = stream.camera.rectified().cropped(*crop)
    return SegmentationTarget(
        image=_rectified_crop(stream, view.frame, crop),
        camera=camera,
        camera_from_object=camera_from_object,
        size=np.asarray(track.size, np.float64),
        object_points=object_points,
        other_points=points_beside(log, track, time, camera_from_world, NearestSweeps(log)),
        category=track.category,
    )


def points_beside(
    log: DrivingLog, track: Track, time: int, camera_from_world: Array, sweeps: NearestSweeps
) -> Array:
    """LiDAR points (M, 3) near a time that are not on a track, camera frame; see `_not_behind`."""
    sweep = sweeps.at(time)
    if sweep is None or not track.trajectory.covers(sweep.timestamp_us):
        return np.zeros((0, 3))
    world = se3.apply(log.world_from_rig.at(sweep.timestamp_us), sweep.points)
    pose = track.trajectory.at(sweep.timestamp_us)
    own = boxes.contains(world, track.size, pose, margin=2 * _BOX_GROWTH)
    # a static point behind the vehicle now is seen through it: only what is not hidden by the
    # box is evidence of background
    moved = se3.apply(camera_from_world, world[~own])
    return _not_behind(moved, camera_from_world @ track.trajectory.at(time), track.size)


def _not_behind(points: Array, camera_from_object: Array, size: Array) -> Array:
    """Camera-frame points (N, 3) that lie before the camera and not behind the object's box."""
    object_from_camera = se3.inverse(camera_from_object)
    eye = object_from_camera[:3, 3]
    half = size / 2 + _BOX_GROWTH
    enter, leave = crossing(eye, se3.apply(object_from_camera, points) - eye, -half, half)
    through = (enter < leave) & (leave > 0) & (enter < 1)
    return points[(points[:, 2] > 0.5) & ~through]


def _crop_window(camera: PinholeCamera, rectangle: Array) -> tuple[int, int, int, int]:
    """Left, top, width, height of a nearly square window around a rectangle, inside the image."""
    centre = (rectangle[:2] + rectangle[2:]) / 2
    side = float(np.max(rectangle[2:] - rectangle[:2])) * (1 + 2 * _CROP_MARGIN)
    low = np.maximum(np.floor(centre - side / 2), 0).astype(int)
    high = np.minimum(np.ceil(centre + side / 2), [camera.width, camera.height]).astype(int)
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


def _rectified_crop(
    stream: CameraStream, frame: int, crop: tuple[int, int, int, int]
) -> NDArray[np.uint8]:
    """The crop (height, width, 3) of one frame, distortion undone."""
    left, top, width, height = crop
    image = stream.images[frame]
    if stream.camera.is_rectified:
        return np.ascontiguousarray(image[top : top + height, left : left + width])
    camera = stream.camera
    grid = camera.cropped(left, top, width, height).pixel_grid()
    normalised = (grid - [camera.cx - left, camera.cy - top]) / [camera.fx, camera.fy]
    source = distort(normalised, camera.distortion) * [camera.fx, camera.fy]
    source += [camera.cx - 0.5, camera.cy - 0.5]  # OpenCV counts pixel centres from zero
    x, y = np.moveaxis(source.astype(np.float32), -1, 0)
    return np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR), dtype=np.uint8)


def observation_of_view(
    rgba: NDArray[np.uint8],
    camera: PinholeCamera,
    camera_from_object: Array,
    size: ArrayLike,
    *,
    name: str,
    category: str = "car",
) -> Observation:
    """The picture, cut to a nearly square window around its mask, as an observation without LiDAR.

    Args:
        rgba: (H, W, 4) uint8, alpha on the vehicle; colours without alpha are kept, generators
            read the light from them.
        camera: camera of the picture, without distortion.
        camera_from_object: (4, 4), object frame: box centre, x forward, y left, z up.
        size: (3,) length, width, height of the vehicle's box, metres.
        name: name of the picture, for the record.
        category: category of the vehicle, see `recast.logs.Track`.

    Raises:
        ValueError: the mask is empty.
    """
    around = mask_rectangle(rgba[..., 3] > 127)
    if around is None:
        raise ValueError("observation_of_view: the mask is empty")
    left, top, width, height = _crop_window(camera, around)
    crop = np.ascontiguousarray(rgba[top : top + height, left : left + width])
    cropped = camera.cropped(left, top, width, height)
    none = np.zeros((0, 3))
    target = SegmentationTarget(
        crop[..., :3], cropped, camera_from_object, np.asarray(size, np.float64), none, none
    )
    pixels = float(np.sqrt((crop[..., 3] > 127).sum()))
    eye = se3.inverse(camera_from_object)[:3, 3]
    view = ViewScore(name, 0, 0, pixels, 1.0, 1.0, 1.0, float(np.arctan2(eye[1], eye[0])))
    return Observation(
        track_id=name,
        category=category,
        size=target.size,
        rgba=crop,
        camera=cropped,
        camera_from_object=np.asarray(camera_from_object, np.float64),
        points=none.astype(np.float32),
        view=view,
        candidates=(view,),
        mask_quality=mask_quality(target, crop[..., 3]),
    )
