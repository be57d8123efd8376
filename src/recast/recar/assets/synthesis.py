"""Training assets of the parametric vehicles and shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.geometry import PinholeCamera, se3
from recast.recar.assets.asset import TrainingAsset
from recast.recar.assets.views import AssetView, sample_views
from recast.recar.assets.voxels import voxelise
from recast.recar.render_identity import studio_sky
from recast.synthetic.rendering import RayScene, render_camera
from recast.synthetic.rendering.surface_points import surface_points
from recast.synthetic.surface import concatenate
from recast.synthetic.world import Sky, VehicleModel

Array = NDArray[np.float64]

_POSES = {"asset": np.eye(4)}


@dataclass(frozen=True)
class AssetSettings:
    """What all assets share.

    Attributes:
        resolution: voxels a side.
        crops, around: pictures, see `sample_views`.
        pixels: width and height of the pictures.
    """

    resolution: int = 32
    crops: int = 8
    around: int = 16
    pixels: int = 128


def make_asset(
    model: VehicleModel, settings: AssetSettings, rng: np.random.Generator
) -> TrainingAsset:
    """Scale a model into the unit cube, take its pictures, and voxelise what they show.

    Raises:
        InputError: embreex is not installed.
    """
    low, high = model.surface.bounds()
    longest = float((high - low).max())
    to_cube = np.eye(4)
    to_cube[:3, 3] = -(low + high) / 2
    # Rays are cast in metres: the ray tracer's offsets are made for them.
    scene = RayScene(concatenate([]), {"asset": model.surface.transformed(to_cube)})
    extents = (high - low) / longest
    sky = studio_sky(rng)
    views = sample_views(rng, extents, settings.crops, settings.around, settings.pixels)
    pictures, points, colours, normals = [], [], [], []
    for view in views:
        picture = _photograph(scene, sky, view, settings.pixels, longest, rng)
        pictures.append(picture)
        seen, normal, colour = _surface(scene, view, settings.pixels, longest, picture)
        points.append(seen / longest)
        normals.append(normal)
        colours.append(colour)
    coords, features = voxelise(
        np.concatenate(points), np.concatenate(colours), np.concatenate(normals),
        settings.resolution,
    )  # fmt: skip
    return TrainingAsset(
        kind=model.kind,
        size=extents.astype(np.float32),
        coords=coords,
        features=features,
        pictures=np.stack(pictures),
        poses=np.stack([se3.inverse(view.pose) for view in views]).astype(np.float32),
        focal=np.array([view.focal for view in views], np.float32),
        crops=settings.crops,
    )


def _metric(pose: Array, longest: float) -> Array:
    scaled = pose.copy()
    scaled[:3, 3] *= longest
    return scaled


def _photograph(
    scene: RayScene, sky: Sky, view: AssetView, pixels: int, longest: float,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:  # fmt: skip
    camera = PinholeCamera(pixels, pixels, view.focal, view.focal, pixels / 2, pixels / 2)
    frame = render_camera(scene, sky, camera, _metric(view.pose, longest), _POSES, rng=rng)
    alpha = np.round(255 * frame.alpha).astype(np.uint8)
    return np.dstack([np.where(alpha[..., None] > 0, frame.rgb, 0), alpha])


def _surface(
    scene: RayScene, view: AssetView, pixels: int, longest: float, picture: NDArray[np.uint8]
) -> tuple[Array, Array, Array]:
    """Points (N, 3) in metres that a view sees, their normals and their display colours."""
    sides = 2 * pixels  # four rays a pixel: enough points in every voxel
    at = (np.arange(sides) + 0.5) / sides * pixels
    u, v = np.meshgrid(at, at)
    rays = np.stack([(u - pixels / 2) / view.focal, (v - pixels / 2) / view.focal,
                     np.ones_like(u)], axis=-1).reshape(-1, 3)  # fmt: skip
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    pose = _metric(view.pose, longest)
    directions = np.ascontiguousarray(rays @ pose[:3, :3].T, np.float32)
    origins = np.ascontiguousarray(np.broadcast_to(pose[:3, 3], directions.shape), np.float32)
    posed = scene.posed(_POSES)
    hit, seen = surface_points(posed, origins, directions, posed.cast(origins, directions))
    row, column = np.divmod(hit, sides)
    colour = picture[row // 2, column // 2]
    solid = colour[:, 3] > 200
    return seen.position[solid], seen.normal[solid], colour[solid, :3] / 255.0
