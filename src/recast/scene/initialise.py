"""First Gaussians of a scene: coloured LiDAR, plane sweep and actors; and how many it may have.

A street needs a number of Gaussians for each square metre; beyond it, more of them hardly sharpen
what cameras a few metres away see. Images that hold few pixels cannot tell where more belong. The
smaller of the two counts, unless the configuration names a number.

Both constants come from trials on a synthetic street that no table of the docs measures
(`arterial-median`, seed 71, 5 s, held-out PSNR). Three cameras of 384x256, 1200 steps, by Gaussians
a square metre: 7: 28.5 dB, 14: 29.6, 27: 30.3, 41 (all that growth asked for): 30.4. One camera of
192x128, 1000 steps, by pixels a Gaussian: 108: 28.2 dB, 54: 29.3, 27: 29.8, 14: 30.2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.arrays import Mask
from recast.core.errors import InputError
from recast.core.records import Record
from recast.logs import DrivingLog, GroundHeight, Track, ego_path, even_ground
from recast.scene.bodies import Body
from recast.scene.config import SceneConfig
from recast.scene.first_points import (
    actor_cloud,
    actor_gaussians,
    body_gaussians,
    coloured_background,
    has_other_side,
    plane_sweep_points,
    without_points_in_sky,
)
from recast.scene.points import (
    DepthSamples,
    OwnedSweep,
    PointCloud,
    concatenate,
    depth_samples,
    gaussians_from_points,
    read_sweeps,
    thinned,
    voxel_downsample,
)
from recast.scene.sky import SkyMap, sky_from_pixels
from recast.scene.sky_masks import sky_masks
from recast.scene.views import TrainingView
from recast.splats import Gaussians

BUDGET_FILE = "budget.json"
BUDGET_VERSION = 1

REACH_M = 25.0
"""Metres of street to either side of the drive that are counted."""
EACH_M2 = 48.0
"""Gaussians per square metre of street."""
PIXELS_EACH = 16.0
"""Pixels of the training images per Gaussian."""
LEAST = 20_000
"""Smallest limit that is derived."""
FIRST_SHARE = 2 / 3
"""Share of the limit that the first points may take, so that growth always has room."""
_CELL_M = 5.0

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
        ground: heights of even ground; None without such ground, or where it is left free.
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
    views: Sequence[TrainingView],
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


def _first_sky(views: Sequence[TrainingView], skies: Sequence[Mask]) -> SkyMap:
    directions, colours = [], []
    for view, sky in zip(views, skies, strict=True):
        rows, columns = np.nonzero(sky)
        rays = view.camera.rays(np.stack([columns, rows], axis=-1) + 0.5)
        directions.append((rays @ view.world_from_camera[:3, :3].T).astype(np.float32))
        colours.append(view.image[rows, columns].astype(np.float32) / 255)
    return sky_from_pixels(np.concatenate(directions), np.concatenate(colours))


class Budget(Record):
    """Contents of budget.json: how many Gaussians there may be, and what came of it.

    Attributes:
        most_gaussians: the limit.
        named: whether the configuration named it; else it was derived from the next two.
        area_m2: street within `REACH_M` of the drive.
        training_pixels: pixels of all training images at the scale of the training.
        first_found, first_kept: first points before and after they were thinned to the limit.
        limited_from: step of the first change of the population that the limit cut short, or None.
        limited_changes: number of changes that the limit cut short.
    """

    version: int = BUDGET_VERSION
    most_gaussians: int
    named: bool
    area_m2: float
    training_pixels: int
    first_found: int = 0
    first_kept: int = 0
    limited_from: int | None = None
    limited_changes: int = 0

    @property
    def was_met(self) -> bool:
        """Whether the limit kept anything from being added."""
        return self.limited_changes > 0 or self.first_kept < self.first_found

    def explain(self) -> str:
        """One line for people."""
        how = "max_gaussians"
        if not self.named:
            pixels = self.training_pixels / 1e6
            how = f"from {self.area_m2:,.0f} m2 of street and {pixels:,.1f} million pixels"
        limit = f"limit of {self.most_gaussians:,} Gaussians ({how})"
        if not self.was_met:
            return f"{limit}: not met"
        parts = []
        if self.first_kept < self.first_found:
            parts.append(f"first points thinned from {self.first_found:,} to {self.first_kept:,}")
        if self.limited_from is not None:
            parts.append(f"{self.limited_changes} changes cut short from step {self.limited_from}")
        return f"{limit}: {', '.join(parts)}"


def gaussian_budget(config: SceneConfig, views: Sequence[TrainingView]) -> Budget:
    """The limit for a training on `views`; those held out do not count."""
    training = [view for view in views if not view.held_out]
    pixels = sum(view.camera.width * view.camera.height for view in training)
    area = street_area(np.array([view.world_from_camera[:2, 3] for view in training]))
    derived = max(LEAST, int(min(EACH_M2 * area, pixels / PIXELS_EACH)))
    return Budget(
        most_gaussians=config.max_gaussians or derived,
        named=config.max_gaussians is not None,
        area_m2=area,
        training_pixels=pixels,
    )


def street_area(positions: NDArray[np.float64]) -> float:
    """Square metres within `REACH_M` of any position (N, 2), in cells of 5 m."""
    steps = np.arange(-REACH_M, REACH_M + _CELL_M, _CELL_M)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    offsets = offsets[np.linalg.norm(offsets, axis=1) <= REACH_M]
    near = np.unique(np.floor(positions / _CELL_M), axis=0) * _CELL_M
    cells = np.unique((near[:, None] + offsets).reshape(-1, 2), axis=0)
    return float(len(cells) * _CELL_M**2)
