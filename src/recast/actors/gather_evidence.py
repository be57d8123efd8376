"""Gather what a log knows of a vehicle."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.actors.evidence import Evidence, Sighting, free_space, settle_masks
from recast.actors.icp import thinned
from recast.actors.observation import NearestSweeps, ViewScore, check_lidar, score_frame
from recast.actors.observe import points_beside, track_of
from recast.actors.segment import (
    SegmentationTarget,
    Segmenter,
    hull_mask,
    mask_rectangle,
    run_segmenter,
)
from recast.arrays import Array
from recast.cameras import PinholeCamera, box_outline, box_rectangle
from recast.core.diagnostics import Progress
from recast.logs import DrivingLog, Track, track_points
from recast.reconstruction import SceneConfig
from recast.reconstruction.views import TrainingView, camera_names, is_held_out, read_view
from recast.scene.street_scene import pose_at

LEAST_HEIGHT = 14.0
"""Pixels of the projected box: in a smaller one nothing is told apart."""
_LEAST_IN_IMAGE = 0.15
_LEAST_VISIBLE = 0.35
_MOST = 120  # images; more of a slow drive show the same again
_MARGIN = 0.22  # share of the box's longer side left around it
_LIDAR_POINTS = 8000  # that a segmenter is given; more say the same
_SHARPNESS_HEIGHT = 32  # pixels at which sharpness is compared


def gather_evidence(
    log: DrivingLog,
    track_id: str,
    *,
    segmenter: Segmenter,
    config: SceneConfig,
    progress: Progress | None = None,
) -> Evidence:
    """All training images of a track with masks, its LiDAR points and the free space in its box.

    Poses are those of the log; `Evidence.posed_by` takes a scene's.

    Args:
        config: cameras, image scale, and which images are held out: those do not enter.
        progress: called with the number of images done, and of all.

    Raises:
        InputError: no such track or camera.
    """
    track = track_of(log, track_id)
    hits = track_points(log, track).points
    scores, left_out = _candidates(log, track, config)
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
    sightings, refused = settle_masks(_weighted_by_sharpness(sightings), track.size)
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


def _candidates(
    log: DrivingLog, track: Track, config: SceneConfig
) -> tuple[list[ViewScore], list[str]]:
    """Training images with the box well in view, in order of time, and why others are not."""
    scores, left_out = [], []
    for name in camera_names(log, config):
        stream = log.cameras[name]
        for frame in range(len(stream.timestamps_us)):
            if is_held_out(frame, config):
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
