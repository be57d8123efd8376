"""First Gaussians: coloured LiDAR, plane-sweep points where it does not reach, actor points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.geometry import boxes, se3
from recast.logs import DrivingLog, Track
from recast.scene.config import SceneConfig
from recast.scene.dynamic import box_rectangle, pose_at
from recast.scene.lidar import (
    DepthSamples,
    OwnedSweep,
    depth_samples,
    project_visible,
    read_sweeps,
)
from recast.scene.plane_sweep import sweep_depths
from recast.scene.point_cloud import (
    PointCloud,
    concatenate,
    gaussians_from_points,
    voxel_downsample,
)
from recast.scene.sky import SkyMap, sky_from_pixels
from recast.scene.sky_mask import sky_mask
from recast.scene.views import View, nearest_view
from recast.splats import Gaussians

Float32Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

COLOUR_LIMIT_US = 160_000
LIDAR_REACH_PX = 5
SWEEP_STRIDE = 3
FEW_POINTS = 200
GRID_SPACING_M = 0.15


@dataclass(frozen=True)
class Initialisation:
    """Where training starts.

    Attributes:
        background: world-frame Gaussians.
        actors: actor-local Gaussians by track id.
        sky: first sky map.
        sky_pixels: (S,) int64 flat indices of sure sky pixels, for each training view.
        depths: measured depths of each training view.
    """

    background: Gaussians
    actors: dict[str, Gaussians]
    sky: SkyMap
    sky_pixels: list[NDArray[np.int64]]
    depths: list[DepthSamples]


def initialise(
    log: DrivingLog,
    views: Sequence[View],
    actors: Mapping[str, Track],
    config: SceneConfig,
    rng: np.random.Generator,
    threads: int = 1,
) -> Initialisation:
    """Build the first scene from the training views and the sweeps not taken with held-out ones.

    Args:
        views: all views; held-out ones lend their timestamps only.
        rng: thins the plane-sweep points.
    """
    training = [view for view in views if not view.held_out]
    sweeps = read_sweeps(log, actors, [view.timestamp_us for view in views if view.held_out])
    depths = [depth_samples(view, sweeps, actors) for view in training]
    skies = [
        sky_mask(view.image, _near_samples(view, samples))
        for view, samples in zip(training, depths, strict=True)
    ]
    clouds = [_coloured_background(sweep, training, actors) for sweep in sweeps]
    lidar = voxel_downsample(concatenate(clouds), config.voxel_m)
    far = _plane_sweep_points(training, depths, skies, actors, config, threads)
    if len(far) > config.sweep_points:
        far = far.select(np.sort(rng.choice(len(far), config.sweep_points, replace=False)))
    cloud = _without_points_in_sky(concatenate([lidar, far]), training, skies)
    return Initialisation(
        background=gaussians_from_points(cloud, config.sh_degree),
        actors={
            track_id: _actor_gaussians(track, sweeps, training, config)
            for track_id, track in actors.items()
        },
        sky=_first_sky(training, skies),
        sky_pixels=[np.flatnonzero(sky) for sky in skies],
        depths=depths,
    )


def _near_samples(view: View, samples: DepthSamples) -> Mask:
    hit = np.zeros((view.camera.height, view.camera.width), np.uint8)
    hit[samples.uv[:, 1].astype(np.int64), samples.uv[:, 0].astype(np.int64)] = 1
    size = 2 * LIDAR_REACH_PX + 1
    return cv2.dilate(hit, np.ones((size, size), np.uint8)) > 0


def _colours(view: View, uv: Float32Array) -> Float32Array:
    rows, columns = uv[:, 1].astype(np.int64), uv[:, 0].astype(np.int64)
    return (view.image[rows, columns] / 255.0).astype(np.float32)


def _usable(view: View, uv: Float32Array) -> Mask:
    if view.mask is None:
        return np.ones(len(uv), bool)
    usable: Mask = view.mask[uv[:, 1].astype(np.int64), uv[:, 0].astype(np.int64)]
    return usable


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


def _coloured_background(
    sweep: OwnedSweep, views: Sequence[View], actors: Mapping[str, Track]
) -> PointCloud:
    points = sweep.background
    clouds = []
    for name in dict.fromkeys(view.camera_name for view in views):
        view = nearest_view(views, sweep.timestamp_us, name, COLOUR_LIMIT_US)
        if view is None:
            continue
        index, uv, depth = project_visible(points, view)
        keep = _usable(view, uv) & ~_behind_actors(view, uv, depth, actors)
        clouds.append(PointCloud(points[index[keep]], _colours(view, uv[keep]), depth[keep]))
    return concatenate(clouds)


def _plane_sweep_points(
    views: Sequence[View],
    depths: Sequence[DepthSamples],
    skies: Sequence[Mask],
    actors: Mapping[str, Track],
    config: SceneConfig,
    threads: int,
) -> PointCloud:
    """Points at pixels without LiDAR near by, from every third training view of each camera."""
    if config.sweep_points == 0:
        return PointCloud.empty()
    clouds = []
    for name in dict.fromkeys(view.camera_name for view in views):
        own = [i for i, view in enumerate(views) if view.camera_name == name]
        references = range(1, len(own) - 1, SWEEP_STRIDE)
        wanted = []
        for reference in references:
            i = own[reference]
            sky = cv2.dilate(skies[i].astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
            mask = ~sky & ~_near_samples(views[i], depths[i])
            wanted.append(mask & ~_actor_pixels(views[i], actors))
        maps = sweep_depths([views[i] for i in own], references, wanted, threads=threads)
        clouds += [
            _unproject(views[own[reference]], depth)
            for reference, depth in zip(references, maps, strict=True)
        ]
    return voxel_downsample(concatenate(clouds), config.voxel_m)


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


def _without_points_in_sky(
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


def _actor_gaussians(
    track: Track,
    sweeps: Sequence[OwnedSweep],
    views: Sequence[View],
    config: SceneConfig,
) -> Gaussians:
    """Gaussians in the box frame: the track's LiDAR points, or a grid where they are too few."""
    clouds = []
    for sweep in sweeps:
        local = sweep.actors.get(track.track_id)
        if local is None or len(local) == 0:
            continue
        for name in dict.fromkeys(view.camera_name for view in views):
            view = nearest_view(views, sweep.timestamp_us, name, COLOUR_LIMIT_US)
            now = None if view is None else pose_at(track.trajectory, view.timestamp_us)
            if view is None or now is None:
                continue
            seen, uv, depth = project_visible(se3.apply(now, local).astype(np.float32), view)
            keep = _usable(view, uv)
            clouds.append(PointCloud(local[seen[keep]], _colours(view, uv[keep]), depth[keep]))
    cloud = voxel_downsample(concatenate(clouds), config.actor_voxel_m)
    if len(cloud) < FEW_POINTS:
        cloud = concatenate([cloud, _box_grid(track, cloud)])
    return gaussians_from_points(cloud, config.sh_degree, sigma_range=(0.01, 0.3))


def _box_grid(track: Track, cloud: PointCloud) -> PointCloud:
    """A grid on the faces of the box in the mean colour of the known points (grey without any)."""
    axes = [
        np.linspace(-size / 2, size / 2, max(2, round(size / GRID_SPACING_M) + 1))
        for size in track.size
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    on_face = np.any(np.isclose(np.abs(grid), track.size / 2), axis=1)
    points = grid[on_face].astype(np.float32)
    mean = cloud.colours.mean(axis=0) if len(cloud) else np.full(3, 0.5, np.float32)
    colours = np.broadcast_to(mean.astype(np.float32), points.shape).copy()
    return PointCloud(points, colours, np.full(len(points), np.inf, np.float32))


def _first_sky(views: Sequence[View], skies: Sequence[Mask]) -> SkyMap:
    directions, colours = [], []
    for view, sky in zip(views, skies, strict=True):
        rows, columns = np.nonzero(sky)
        rays = view.camera.rays(np.stack([columns, rows], axis=-1) + 0.5)
        directions.append((rays @ view.world_from_camera[:3, :3].T).astype(np.float32))
        colours.append(view.image[rows, columns].astype(np.float32) / 255)
    return sky_from_pixels(np.concatenate(directions), np.concatenate(colours))
