"""First Gaussians of an actor, in its box frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy.spatial import cKDTree

from recast.geometry import se3
from recast.logs import Track
from recast.scene.background_points import COLOUR_LIMIT_US, pixel_colours, usable_pixels
from recast.scene.bodies import Body
from recast.scene.config import SceneConfig
from recast.scene.dynamic import deforms, pose_at
from recast.scene.lidar import OwnedSweep, project_visible
from recast.scene.mirror import DEFORMABLE, with_other_side
from recast.scene.point_cloud import (
    PointCloud,
    concatenate,
    gaussians_from_points,
    voxel_downsample,
)
from recast.scene.views import View, nearest_view
from recast.splats import Gaussians
from recast.splats.sh import C0

FEW_POINTS = 200
GRID_SPACING_M = 0.15


def actor_cloud(
    track: Track, sweeps: Sequence[OwnedSweep], views: Sequence[View], config: SceneConfig
) -> PointCloud:
    """Points in the box frame: the track's LiDAR points, or a grid where they are too few."""
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
            keep = usable_pixels(view, uv)
            clouds.append(PointCloud(local[seen[keep]], pixel_colours(view, uv[keep]), depth[keep]))
    cloud = voxel_downsample(concatenate(clouds), config.actor_voxel_m)
    if len(cloud) < FEW_POINTS:
        return concatenate([cloud, _box_grid(track, cloud)])
    return cloud


def actor_gaussians(track: Track, cloud: PointCloud, config: SceneConfig) -> Gaussians:
    """First Gaussians of an actor's points; with its other side, where steps see it mirrored."""
    gaussians = gaussians_from_points(cloud, config.sh_degree, sigma_range=(0.01, 0.3))
    return with_other_side(gaussians) if has_other_side(track, config) else gaussians


def body_gaussians(track: Track, body: Body, cloud: PointCloud, config: SceneConfig) -> Gaussians:
    """First Gaussians of a body at rest, one a vertex and in their order.

    Their colours are those of the points nearest to where they are in the middle of their time.
    """
    vertices = body.vertices.astype(np.float32)
    never = np.full(len(vertices), np.inf, np.float32)
    grey = PointCloud(vertices, np.full((len(vertices), 3), 0.5, np.float32), never)
    gaussians = gaussians_from_points(grey, config.sh_degree, sigma_range=(0.01, 0.3))
    times = body.skinning.timestamps_us
    middle = int(times[0] + times[-1]) // 2
    placed = body.skinning.at(gaussians, track.trajectory, middle).means.numpy()
    _, nearest = cKDTree(cloud.points).query(placed)
    gaussians.sh[:, 0] = (torch.from_numpy(cloud.colours[nearest]) - 0.5) / C0
    return gaussians


def has_other_side(track: Track, config: SceneConfig) -> bool:
    """Whether an actor begins with twice as many Gaussians as points."""
    symmetric = track.category not in DEFORMABLE and not deforms(track, config)
    return config.flip_probability > 0 and symmetric


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
