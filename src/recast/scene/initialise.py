"""First Gaussians: coloured LiDAR, plane-sweep points where it does not reach, actor points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.logs import DrivingLog, GroundHeight, Track, ego_path, even_ground
from recast.scene.actor_points import (
    actor_cloud,
    actor_gaussians,
    body_gaussians,
    has_other_side,
)
from recast.scene.background_points import (
    coloured_background,
    plane_sweep_points,
    without_points_in_sky,
)
from recast.scene.bodies import Body
from recast.scene.budget import FIRST_SHARE
from recast.scene.config import SceneConfig
from recast.scene.lidar import DepthSamples, OwnedSweep, depth_samples, read_sweeps
from recast.scene.point_cloud import (
    PointCloud,
    concatenate,
    gaussians_from_points,
    thinned,
    voxel_downsample,
)
from recast.scene.sky import SkyMap, sky_from_pixels
from recast.scene.sky_masks import sky_masks
from recast.scene.views import View
from recast.splats import Gaussians

Mask = NDArray[np.bool_]

MIN_POINTS = 100


@dataclass(frozen=True)
class Initialisation:
    """Where training starts.

    Attributes:
        background: world-frame Gaussians.
        actors: actor-local Gaussians by track id.
        sky: first sky map.
        sky_pixels: (S,) int64 flat indices of sure sky pixels, for each training view.
        depths: measured depths of each training view.
        ground: where the ground is even and how high; None without such ground, or where it is
            left free.
        found: Gaussians that there would have been without `max_gaussians`.
    """

    background: Gaussians
    actors: dict[str, Gaussians]
    sky: SkyMap
    sky_pixels: list[NDArray[np.int64]]
    depths: list[DepthSamples]
    ground: GroundHeight | None = None
    found: int = 0

    def __len__(self) -> int:
        return len(self.background) + sum(len(part) for part in self.actors.values())


def initialise(
    log: DrivingLog,
    views: Sequence[View],
    actors: Mapping[str, Track],
    config: SceneConfig,
    rng: np.random.Generator,
    threads: int = 1,
    bodies: Mapping[str, Body] | None = None,
) -> Initialisation:
    """Build the first scene from the training views and the sweeps not taken with held-out ones.

    Args:
        views: all views; held-out ones lend their timestamps only.
        rng: thins the plane-sweep points, and all points where they are too many for
            `max_gaussians`.
        bodies: actors that begin as the vertices of a body, all of them.

    Raises:
        InputError: LiDAR and images together give next to no points.
    """
    training = [view for view in views if not view.held_out]
    sweeps = read_sweeps(log, actors, [view.timestamp_us for view in views if view.held_out])
    depths = [depth_samples(view, sweeps, actors) for view in training]
    skies = sky_masks(log, training, depths, config)
    clouds = [coloured_background(sweep, training, actors) for sweep in sweeps]
    lidar = voxel_downsample(concatenate(clouds), config.voxel_m)
    far = PointCloud.empty()
    if config.sweep_points:
        swept = plane_sweep_points(training, depths, skies, actors, threads)
        far = voxel_downsample(swept, config.voxel_m)
    if len(far) > config.sweep_points:
        far = far.select(np.sort(rng.choice(len(far), config.sweep_points, replace=False)))
    cloud = without_points_in_sky(concatenate([lidar, far]), training, skies)
    if len(cloud) < MIN_POINTS:
        raise InputError(
            log.name,
            "LiDAR",
            f"{len(cloud)} points in view of the cameras, at least {MIN_POINTS} are needed",
            "check the calibration, or import the sweeps",
        )
    clouds_of = {
        name: actor_cloud(track, sweeps, training, config) for name, track in actors.items()
    }
    bodies = bodies or {}
    found = len(cloud) + sum(
        len(own) * (1 + has_other_side(actors[name], config))
        for name, own in clouds_of.items()
        if name not in bodies
    )
    share = 1.0 if config.max_gaussians is None else FIRST_SHARE * config.max_gaussians / found
    found += sum(len(body.vertices) for body in bodies.values())
    return Initialisation(
        background=gaussians_from_points(thinned(cloud, share, rng), config.sh_degree),
        actors={
            name: body_gaussians(actors[name], bodies[name], own, config)
            if name in bodies
            else actor_gaussians(actors[name], thinned(own, share, rng), config)
            for name, own in clouds_of.items()
        },
        sky=_first_sky(training, skies),
        sky_pixels=[np.flatnonzero(sky) for sky in skies],
        depths=depths,
        ground=_even_ground(log, sweeps) if config.ground_tolerance_m > 0 else None,
        found=found,
    )


def _even_ground(log: DrivingLog, sweeps: Sequence[OwnedSweep]) -> GroundHeight | None:
    path = ego_path(log.world_from_rig)
    if path is None or not sweeps:
        return None
    found = even_ground((sweep.background.astype(np.float64) for sweep in sweeps), path)
    return found if np.isfinite(found.height).any() else None


def _first_sky(views: Sequence[View], skies: Sequence[Mask]) -> SkyMap:
    directions, colours = [], []
    for view, sky in zip(views, skies, strict=True):
        rows, columns = np.nonzero(sky)
        rays = view.camera.rays(np.stack([columns, rows], axis=-1) + 0.5)
        directions.append((rays @ view.world_from_camera[:3, :3].T).astype(np.float32))
        colours.append(view.image[rows, columns].astype(np.float32) / 255)
    return sky_from_pixels(np.concatenate(directions), np.concatenate(colours))
