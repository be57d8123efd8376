"""What a log shows of a vehicle: the best view of a track, cut out, and all other evidence."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.actors.evidence import Evidence, Sighting, free_space, settle_masks
from recast.actors.icp import thinned
from recast.actors.observation import (
    NearestSweeps,
    Observation,
    Usable,
    ViewPool,
    ViewScore,
    check_lidar,
    crossing,
    score_frame,
)
from recast.actors.segment import (
    SegmentationTarget,
    Segmenter,
    hull_mask,
    mask_quality,
    mask_rectangle,
    run_segmenter,
)
from recast.arrays import Array
from recast.cameras import PinholeCamera, box_outline, box_rectangle
from recast.cameras.pinhole import distort
from recast.core.diagnostics import Progress
from recast.core.errors import InputError
from recast.geometry import boxes, se3
from recast.logs import CameraStream, DrivingLog, Track, track_points
from recast.logs.load import arc
from recast.logs.types import PEOPLE
from recast.reconstruction import SceneConfig
from recast.reconstruction.views import TrainingView, camera_names, is_held_out, read_view
from recast.scene.street_scene import pose_at

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


def why_not_seen(
    log: DrivingLog, track_id: str, lidar_points: int, config: SceneConfig
) -> str | None:
    """Why a vehicle cannot be made from what the log saw of it, in words; None if it can.

    Args:
        lidar_points: number of LiDAR points in its boxes.
        config: settings of the street's scene: cameras, image scale, and held-out frames.
    """
    track = track_of(log, track_id)
    if lidar_points < MIN_LIDAR_POINTS:
        return f"it has {lidar_points} LiDAR points, fewer than {MIN_LIDAR_POINTS}"
    scores, left_out = _candidates(log, track, config, training_frames(config))
    if scores:
        return None
    why = Counter(left_out).most_common(1)
    return f"in no image it is seen well enough: {why[0][0]}" if why else "no camera sees it"


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


LEAST_HEIGHT = 14.0
"""Pixels of the projected box: in a smaller one nothing is told apart."""
_LEAST_IN_IMAGE = 0.15
_LEAST_VISIBLE = 0.35
_MOST = 60  # images; with 40, 60 and 120 a vehicle of urban-straight 41 came out alike
_MARGIN = 0.22  # share of the box's longer side left around it
_LIDAR_POINTS = 8000  # that a segmenter is given; more say the same
_SHARPNESS_HEIGHT = 32  # pixels at which sharpness is compared


def gather_evidence(
    log: DrivingLog,
    track_id: str,
    *,
    segmenter: Segmenter,
    config: SceneConfig,
    hits: NDArray[np.float32] | None = None,
    usable: Usable | None = None,
    progress: Progress | None = None,
) -> Evidence:
    """All training images of a track with masks, its LiDAR points and the free space in its box.

    Poses are those of the log; `Evidence.posed_by` takes a scene's.

    Args:
        config: cameras, image scale, and which images are held out: those do not enter.
        hits: (N, 3) LiDAR points of the track, if they have been read: `track_points`.
        usable: tells which frames enter; None: those that are not held out.
        progress: called with the number of images done, and of all.

    Raises:
        InputError: no such track or camera.
    """
    track = track_of(log, track_id)
    hits = track_points(log, track).points if hits is None else hits
    if usable is None:
        usable = training_frames(config)
    scores, left_out = _candidates(log, track, config, usable)
    few = thinned(hits, _LIDAR_POINTS)
    sweeps = NearestSweeps(log)
    sightings: list[Sighting] = []
    for index, score in enumerate(scores):
        score = check_lidar(log, track, score, sweeps)
        if score.unblocked * score.unoccluded < _LEAST_VISIBLE:
            left_out.append("hidden by another object")
        else:
            sighting = _sight(log, track, score, few, segmenter, config, sweeps)
            if sighting is None:
                left_out.append("no mask")
            else:
                sightings.append(sighting)
        if progress is not None:
            progress(index + 1, len(scores))
    sightings = _weighted_by_sharpness(sightings)
    if track.category not in PEOPLE:  # limbs that move have no hull
        sightings, refused = settle_masks(sightings, track.size)
        left_out += ["mask contradicts the other masks"] * len(refused)
    return Evidence(
        track_id=track_id,
        category=track.category,
        size=np.asarray(track.size, np.float64),
        sightings=tuple(sightings),
        hits=hits,
        free=free_space(log, track, hits),
        left_out=tuple(left_out),
    )


def training_frames(config: SceneConfig) -> Usable:
    """The frames that a scene is trained on: those held out must not lead to its actors either."""
    return lambda camera, frame: not is_held_out(frame, config)


@dataclass(frozen=True)
class TrackSides:
    """The images of a track, split by the direction that they show it from.

    Attributes:
        kept: what may be looked at.
        between: images less than the angle away from some of `kept`, which are not used at all.
        hidden: images that are farther from each of `kept`.
    """

    kept: tuple[ViewScore, ...]
    between: tuple[ViewScore, ...]
    hidden: tuple[ViewScore, ...]


def split_sides(log: DrivingLog, track_id: str, config: SceneConfig, degrees: float) -> TrackSides:
    """Split a track's images into those of one side and those of another.

    The images that show it well enough for `gather_evidence`, held-out ones too, are sorted by the
    direction from its box to the camera. Kept are those from one end of the arc, hidden those more
    than `degrees` away from all of them: of all such splits, from either end, the one with the most
    images in its smaller part.

    Raises:
        InputError: the images do not span the angle; or no such track or camera.
    """
    track = track_of(log, track_id)
    views, _ = _candidates(log, track, config, lambda camera, frame: True)
    start, span = arc([np.degrees(one.azimuth) for one in views]) if views else (0.0, 0.0)
    best = TrackSides((), (), ())

    def along(one: ViewScore) -> float:
        return float((np.degrees(one.azimuth) - start + 1e-6) % 360.0)

    for ordered in (sorted(views, key=along), sorted(views, key=lambda one: -along(one))):
        for count in range(1, len(ordered)):
            edge = along(ordered[count - 1])
            apart = [abs(along(one) - edge) > degrees for one in ordered[count:]]
            between = len(apart) - sum(apart)
            split = TrackSides(
                tuple(ordered[:count]),
                tuple(ordered[count : count + between]),
                tuple(ordered[count + between :]),
            )
            if min(len(split.kept), len(split.hidden)) > min(len(best.kept), len(best.hidden)):
                best = split
    if not best.hidden:
        raise InputError(
            log.name,
            f"track {track_id}",
            f"is seen over {span:.0f} degrees, so that none of its images is {degrees:g} degrees "
            "from all others that are kept",
            "hide less or choose another track; `recast log info` lists how much each spans",
        )
    return best


def without_sides(
    log: DrivingLog, track_id: str, hidden: Sequence[ViewScore], growth: float = 0.25
) -> DrivingLog:
    """The log with a track's box, grown by a share of its sides, hidden in some images; see
    `CameraStream.hidden`."""
    track, cameras = track_of(log, track_id), dict(log.cameras)
    for one in hidden:
        stream = cameras[one.camera]
        camera_from_world = se3.inverse(
            log.world_from_rig.at(one.timestamp_us) @ stream.rig_from_camera
        )
        pose = camera_from_world @ track.trajectory.at(one.timestamp_us)
        box = box_rectangle(track.size * (1 + growth), pose, stream.camera.rectified())
        assert box is not None  # the image shows it
        left, top, right, bottom = (float(edge) for edge in box)
        frames = {**stream.hidden, one.frame: (left, top, right, bottom)}
        cameras[one.camera] = replace(stream, hidden=frames)
    return replace(log, cameras=cameras)


def _candidates(
    log: DrivingLog, track: Track, config: SceneConfig, usable: Usable
) -> tuple[list[ViewScore], list[str]]:
    """Usable images with the box well in view, in order of time, and why others are not."""
    scores, left_out = [], []
    for name in camera_names(log, config):
        stream = log.cameras[name]
        for frame in range(len(stream.timestamps_us)):
            if not usable(name, frame):
                continue
            score = score_frame(log, track, stream, frame)
            if score is None:
                continue
            if score.size_px * config.scale < LEAST_HEIGHT:
                left_out.append(f"smaller than {LEAST_HEIGHT:g} pixels")
            elif score.in_image < _LEAST_IN_IMAGE:
                left_out.append("mostly outside the image")
            elif score.unoccluded < _LEAST_VISIBLE:
                left_out.append("hidden by another object")
            else:
                scores.append(score)
    scores.sort(key=lambda score: (score.timestamp_us, score.camera))
    if len(scores) > _MOST:
        left_out += [f"{_MOST} images are enough"] * (len(scores) - _MOST)
        scores = [scores[i] for i in np.linspace(0, len(scores) - 1, _MOST).round().astype(int)]
    return scores, left_out


def _sight(
    log: DrivingLog,
    track: Track,
    score: ViewScore,
    hits: NDArray[np.float32],
    segmenter: Segmenter,
    config: SceneConfig,
    sweeps: NearestSweeps,
) -> Sighting | None:
    """One image cut to the vehicle; None where the segmenter finds nothing."""
    view = read_view(log, log.cameras[score.camera], score.frame, config.scale)
    world_from_object = pose_at(track.trajectory, view.timestamp_us)
    if world_from_object is None:
        return None
    camera_from_world = view.camera_from_world
    camera_from_object = camera_from_world @ world_from_object
    window = _window(view.camera, box_rectangle(track.size, camera_from_object, view.camera))
    if window is None:
        return None
    left, top, width, height = window
    part = (slice(top, top + height), slice(left, left + width))
    camera = view.camera.cropped(left, top, width, height)
    target = SegmentationTarget(
        image=np.ascontiguousarray(view.image[part]),
        camera=camera,
        camera_from_object=camera_from_object,
        size=np.asarray(track.size, np.float64),
        object_points=np.asarray(hits, np.float64),
        other_points=points_beside(log, track, view.timestamp_us, camera_from_world, sweeps),
        category=track.category,
    )
    mask = (run_segmenter(segmenter, target).alpha / 255).astype(np.float32)
    usable = ~_hidden(log, track, view, camera, camera_from_world, camera_from_object)
    if view.mask is not None:
        usable &= view.mask[part]
    if not (mask[usable] > 0.5).any():
        return None
    return Sighting(
        camera_name=view.camera_name,
        frame=view.frame,
        timestamp_us=view.timestamp_us,
        camera=camera,
        camera_from_world=camera_from_world,
        world_from_object=world_from_object,
        image=target.image,
        mask=mask,
        trust=usable.astype(np.float32),
        weight=score.unoccluded * score.unblocked * score.in_image,
    )


def _window(camera: PinholeCamera, rectangle: Array | None) -> tuple[int, int, int, int] | None:
    """Left, top, width, height around a projected box, inside the image."""
    if rectangle is None:
        return None
    margin = max(_MARGIN * float(np.max(rectangle[2:] - rectangle[:2])), 6.0)
    low = np.maximum(np.floor(rectangle[:2] - margin), 0).astype(int)
    high = np.minimum(np.ceil(rectangle[2:] + margin), [camera.width, camera.height]).astype(int)
    if np.any(high - low < 8):
        return None
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


def _hidden(
    log: DrivingLog,
    track: Track,
    view: TrainingView,
    camera: PinholeCamera,
    camera_from_world: Array,
    camera_from_object: Array,
) -> NDArray[np.bool_]:
    """Pixels (H, W) of the crop on which the box of a nearer track lies."""
    hidden = np.zeros((camera.height, camera.width), bool)
    for other in log.tracks.values():
        pose = pose_at(other.trajectory, view.timestamp_us)
        if other.track_id == track.track_id or pose is None:
            continue
        camera_from_other = camera_from_world @ pose
        if np.linalg.norm(camera_from_other[:3, 3]) < np.linalg.norm(camera_from_object[:3, 3]):
            pixels = box_outline(other.size, camera_from_other, camera)
            hidden |= hull_mask(pixels, hidden.shape)
    return hidden


def _weighted_by_sharpness(sightings: list[Sighting]) -> list[Sighting]:
    """Weights lowered by size, as half the largest counts half, and by blur."""
    if not sightings:
        return []
    sizes = np.array([np.sqrt((one.mask > 0.5).sum()) for one in sightings])
    sharp = np.array([_sharpness(one) for one in sightings])
    by_size = np.clip(sizes / np.quantile(sizes, 0.9), 0.1, 1.0)
    by_sharpness = np.clip(sharp / max(float(np.median(sharp)), 1e-9), 0.5, 1.0)
    return [
        replace(one, weight=float(one.weight * a * b))
        for one, a, b in zip(sightings, by_size, by_sharpness, strict=True)
    ]


def _sharpness(sighting: Sighting) -> float:
    """Mean size of the Laplacian over that of the gradient on the vehicle, at one common size."""
    around = mask_rectangle(sighting.mask > 0.5)
    assert around is not None  # see `_sight`
    left, top, right, bottom = around.astype(int)
    part = sighting.image[top:bottom, left:right]
    grey = cv2.cvtColor(np.ascontiguousarray(part), cv2.COLOR_RGB2GRAY).astype(np.float32)
    width = max(round(grey.shape[1] * _SHARPNESS_HEIGHT / grey.shape[0]), 4)
    size = (width, _SHARPNESS_HEIGHT)
    grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.float32)
    slope = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))
    return float(np.abs(cv2.Laplacian(grey, cv2.CV_32F)).mean() / max(float(slope.mean()), 1e-6))
