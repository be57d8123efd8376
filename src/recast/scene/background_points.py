"""Coloured points of the background: LiDAR, and a plane sweep where it does not reach."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.geometry import boxes, se3
from recast.logs import Track
from recast.scene.dynamic import box_rectangle, pose_at
from recast.scene.lidar import DepthSamples, OwnedSweep, project_visible
from recast.scene.plane_sweep import sweep_depths
from recast.scene.point_cloud import PointCloud, concatenate
from recast.scene.views import View, nearest_view

Float32Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

COLOUR_LIMIT_US = 160_000
"""A sweep takes its colours from images at most this far away in time."""
LIDAR_REACH_PX = 5
SWEEP_STRIDE = 3


def near_samples(view: View, samples: DepthSamples) -> Mask:
    """Pixels (H, W) within a few pixels of a LiDAR return."""
    hit = np.zeros((view.camera.height, view.camera.width), np.uint8)
    hit[samples.uv[:, 1].astype(np.int64), samples.uv[:, 0].astype(np.int64)] = 1
    size = 2 * LIDAR_REACH_PX + 1
    return cv2.dilate(hit, np.ones((size, size), np.uint8)) > 0


def pixel_colours(view: View, uv: Float32Array) -> Float32Array:
    """Image colours (M, 3) in [0, 1] at pixel coordinates (M, 2)."""
    rows, columns = uv[:, 1].astype(np.int64), uv[:, 0].astype(np.int64)
    return (view.image[rows, columns] / 255.0).astype(np.float32)


def usable_pixels(view: View, uv: Float32Array) -> Mask:
    """Which pixel coordinates (M, 2) the view's mask lets count."""
    if view.mask is None:
        return np.ones(len(uv), bool)
    usable: Mask = view.mask[uv[:, 1].astype(np.int64), uv[:, 0].astype(np.int64)]
    return usable


def coloured_background(
    sweep: OwnedSweep, views: Sequence[View], actors: Mapping[str, Track]
) -> PointCloud:
    """A sweep's background points with colours from the views nearest in time, one a camera."""
    points = sweep.background
    clouds = []
    for name in dict.fromkeys(view.camera_name for view in views):
        view = nearest_view(views, sweep.timestamp_us, name, COLOUR_LIMIT_US)
        if view is None:
            continue
        index, uv, depth = project_visible(points, view)
        keep = usable_pixels(view, uv) & ~_behind_actors(view, uv, depth, actors)
        clouds.append(PointCloud(points[index[keep]], pixel_colours(view, uv[keep]), depth[keep]))
    return concatenate(clouds)


def _behind_actors(
    view: View, uv: Float32Array, depth: Float32Array, actors: Mapping[str, Track]
) -> Mask:
    """Points whose pixel may show a moving object in front of them at the view's own time."""
    hidden = np.zeros(len(uv), bool)
    for track in actors.values():
        pose = pose_at(track.trajectory, view.timestamp_us)
        rectangle = None if pose is None else box_rectangle(track.size, pose, view)
        if pose is None or rectangle is None:
            continue
        left, top, right, bottom = rectangle
        inside = (uv[:, 0] >= left) & (uv[:, 0] < right) & (uv[:, 1] >= top) & (uv[:, 1] < bottom)
        nearest = se3.apply(view.camera_from_world, boxes.corners(track.size, pose))[:, 2].min()
        hidden |= inside & (depth > nearest)
    return hidden


def plane_sweep_points(
    views: Sequence[View],
    depths: Sequence[DepthSamples],
    skies: Sequence[Mask],
    actors: Mapping[str, Track],
    threads: int,
) -> PointCloud:
    """Points at pixels without LiDAR near by, from every third view of each camera.

    Sky, moving objects and unusable pixels are left out.

    Args:
        views: in order of time within a camera; depths and skies are those of each view.
    """
    clouds = []
    for name in dict.fromkeys(view.camera_name for view in views):
        own = [i for i, view in enumerate(views) if view.camera_name == name]
        references = range(1, len(own) - 1, SWEEP_STRIDE)
        wanted = []
        for reference in references:
            i = own[reference]
            sky = cv2.dilate(skies[i].astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
            mask = ~sky & ~near_samples(views[i], depths[i])
            wanted.append(mask & ~_actor_pixels(views[i], actors))
        maps = sweep_depths([views[i] for i in own], references, wanted, threads=threads)
        clouds += [
            _unproject(views[own[reference]], depth)
            for reference, depth in zip(references, maps, strict=True)
        ]
    return concatenate(clouds)


def _actor_pixels(view: View, actors: Mapping[str, Track]) -> Mask:
    covered = np.zeros((view.camera.height, view.camera.width), bool)
    if view.mask is not None:
        covered |= ~view.mask
    for track in actors.values():
        pose = pose_at(track.trajectory, view.timestamp_us)
        rectangle = None if pose is None else box_rectangle(track.size, pose, view)
        if rectangle is not None:
            left, top = np.floor(rectangle[:2]).astype(int) - 3
            right, bottom = np.ceil(rectangle[2:]).astype(int) + 3
            covered[max(top, 0) : bottom, max(left, 0) : right] = True
    return covered


def _unproject(view: View, depth: Float32Array) -> PointCloud:
    rows, columns = np.nonzero(depth)
    distance = depth[rows, columns]
    pixels = np.stack([columns, rows], axis=-1) + 0.5
    points = se3.apply(view.world_from_camera, view.camera.unproject(pixels, distance))
    colours = (view.image[rows, columns] / 255.0).astype(np.float32)
    return PointCloud(points.astype(np.float32), colours, distance)


def without_points_in_sky(
    cloud: PointCloud, views: Sequence[View], skies: Sequence[Mask], strikes: int = 2
) -> PointCloud:
    """Drop points that `strikes` views see in front of plain sky: wrong matches, stray returns."""
    hits = np.zeros(len(cloud), np.int64)
    for view, sky in zip(views, skies, strict=True):
        local = cloud.points @ view.camera_from_world[:3, :3].T.astype(np.float32)
        local += view.camera_from_world[:3, 3].astype(np.float32)
        front = np.flatnonzero(local[:, 2] > 1.0)
        uv = local[front, :2] / local[front, 2:]
        columns = np.floor(uv[:, 0] * view.camera.fx + view.camera.cx).astype(np.int64)
        rows = np.floor(uv[:, 1] * view.camera.fy + view.camera.cy).astype(np.int64)
        inside = (columns >= 0) & (rows >= 0) & (columns < sky.shape[1]) & (rows < sky.shape[0])
        hits[front[inside]] += sky[rows[inside], columns[inside]]
    return cloud.select(hits < strikes)
