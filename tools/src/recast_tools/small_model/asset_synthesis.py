"""Training assets of the parametric vehicles and shapes: a folder, made by several processes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from recast.arrays import Array
from recast.cameras import PinholeCamera
from recast.core.diagnostics import Progress, tell
from recast.core.errors import InputError
from recast.core.files import alone_in, write_json
from recast.core.records import Record, read_record
from recast.core.workers import worker_pool
from recast.geometry import se3
from recast.recar.synthesis import studio_sky
from recast.recar.training_conditions import TrainingAsset, write_asset
from recast.recar.views import camera_pose, fitting_distance, pinhole
from recast.synthetic.rendering import RayScene, render_camera, require_embree
from recast.synthetic.rendering.surface_points import surface_points
from recast.synthetic.surface import concatenate
from recast.synthetic.vehicles import sample_shape, sample_vehicle
from recast.synthetic.world import Sky, VehicleModel

_POSES = {"asset": np.eye(4)}
RECORD_FILE = "assets.json"
_MEND = "choose a new folder, or make the assets again"


class AssetsRecord(Record):
    """What all assets of a folder share, as written to `assets.json`.

    Attributes:
        seed: seed of everything random; asset i depends on seed and i alone.
        shape_every: number n; every n-th asset is another shape than a vehicle, 0 none.
        resolution: number of voxels a side.
        crops, around, pixels: pictures of each, see `sample_views`.
    """

    format: Literal["recast-training-assets"] = "recast-training-assets"
    version: Literal[1] = 1
    seed: int = Field(default=0, ge=0)
    shape_every: int = Field(default=4, ge=0)
    resolution: int = Field(default=32, ge=8, le=256)
    crops: int = Field(default=8, ge=1)
    around: int = Field(default=16, ge=1)
    pixels: int = Field(default=128, ge=32)


def make_assets(
    out: Path,
    count: int,
    record: AssetsRecord,
    *,
    workers: int = 1,
    progress: Progress | None = None,
) -> None:
    """Make the first `count` assets of a seed; those that are there already are kept.

    Raises:
        InputError: `out` holds assets of other settings, embreex is not installed, a count or a
            number of workers below one, or the disk is full.
    """
    for option, value in (("`count`", count), ("`workers`", workers)):
        if value < 1:
            raise InputError(option, "value", f"is {value}", "give 1 or more")
    require_embree()
    path = out / RECORD_FILE
    if path.exists():
        found = read_record(path, AssetsRecord, 1, _MEND, record.format)
        if found != record:
            raise InputError(path, "settings", "differ from the requested ones", _MEND)
    else:
        write_json(path, record.model_dump(mode="json"))
    left = [i for i in range(count) if not asset_path(out, i).exists()]
    done, indices = count - len(left), iter(left)
    tell(progress, done, count)
    pool = worker_pool(min(workers, len(left)) or 1)
    with alone_in(out):
        for _ in pool(_start, (out, record), lambda: next(indices, None), "finished assets"):
            done += 1
            tell(progress, done, count)


def asset_path(folder: Path, index: int) -> Path:
    """Where an asset lies."""
    return folder / f"asset-{index:05d}.npz"


def _start(_: int, out: Path, record: AssetsRecord) -> Callable[[int], None]:
    return partial(_make, out, record=record)


def _make(out: Path, index: int, record: AssetsRecord) -> None:
    rng = np.random.default_rng([record.seed, index])
    shape = record.shape_every and index % record.shape_every == record.shape_every - 1
    model = sample_shape(rng) if shape else sample_vehicle(rng)
    write_asset(asset_path(out, index), make_asset(model, record, rng))


def make_asset(
    model: VehicleModel, record: AssetsRecord, rng: np.random.Generator
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
    views = sample_views(rng, extents, record.crops, record.around, record.pixels)
    pictures, points, colours, normals = [], [], [], []
    for view in views:
        picture = _photograph(scene, sky, view, record.pixels, longest, rng)
        pictures.append(picture)
        seen, normal, colour = _surface(scene, view, record.pixels, longest, picture)
        points.append(seen / longest)
        normals.append(normal)
        colours.append(colour)
    coords, features = voxelise(
        np.concatenate(points),
        np.concatenate(colours),
        np.concatenate(normals),
        record.resolution,
    )
    return TrainingAsset(
        kind=model.kind,
        size=extents.astype(np.float32),
        coords=coords,
        features=features,
        pictures=np.stack(pictures),
        poses=np.stack([se3.inverse(view.pose) for view in views]).astype(np.float32),
        focal=np.array([view.focal for view in views], np.float32),
        crops=record.crops,
    )


def _metric(pose: Array, longest: float) -> Array:
    scaled = pose.copy()
    scaled[:3, 3] *= longest
    return scaled


def _photograph(
    scene: RayScene,
    sky: Sky,
    view: AssetView,
    pixels: int,
    longest: float,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
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
    rays = np.stack(
        [(u - pixels / 2) / view.focal, (v - pixels / 2) / view.focal, np.ones_like(u)], axis=-1
    ).reshape(-1, 3)
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


@dataclass(frozen=True)
class AssetView:
    """One camera.

    Attributes:
        focal: focal length in pixels.
        pose: (4, 4) `asset_from_camera`, unit cube.
    """

    focal: float
    pose: Array


def sample_views(
    rng: np.random.Generator, extents: Array, crops: int, around: int, pixels: int
) -> list[AssetView]:
    """Cameras that see the whole asset, azimuths spread evenly with a random start.

    Args:
        extents: (3,) extents of the asset in the unit cube.
        crops: cameras as on a car: 0 to 15 degrees above the horizon, through lenses of 10 to 45
            degrees.
        around: cameras anywhere from 10 degrees below to 75 above, of 40 degrees, to learn shape
            and colour from.
        pixels: width and height of the pictures.
    """
    views = []
    for count, low, high, lens in ((crops, 0.0, 15.0, (10.0, 45.0)), (around, -10.0, 75.0, None)):
        start = rng.uniform(0, 360)
        # even in the sine of the elevation, so that the views are spread evenly over the sphere
        sines = rng.uniform(np.sin(np.radians(low)), np.sin(np.radians(high)), count)
        for index in range(count):
            fov = 40.0 if lens is None else float(np.exp(rng.uniform(*np.log(lens))))
            camera = pinhole(pixels, pixels, fov)
            elevation = float(np.degrees(np.arcsin(sines[index])))
            azimuth = start + 360.0 * (index + rng.uniform(-0.5, 0.5)) / count
            distance = fitting_distance(extents, camera, elevation, azimuths_deg=(azimuth,))
            views.append(AssetView(camera.fx, camera_pose(azimuth, elevation, distance)))
    return views


def voxelise(
    points: Array, colours: Array, normals: Array, resolution: int, least: int = 2
) -> tuple[NDArray[np.uint8], NDArray[np.float16]]:
    """Bin points of a surface into a grid over the unit cube.

    Args:
        points: (N, 3) points in [-0.5, 0.5]; those outside are left out.
        colours: (N, 3) display values in [0, 1].
        normals: (N, 3) unit normals.
        resolution: R voxels a side.
        least: number of points that make a voxel occupied; lonely ones are often rounding.

    Returns:
        Coordinates (T, 3), lexicographic, and features (T, 17), see `assets.FEATURES`.
    """
    scaled = (points + 0.5) * resolution
    inside = np.all((scaled >= 0) & (scaled < resolution), axis=1)
    scaled, colours, normals = scaled[inside], colours[inside], normals[inside]
    cell = np.floor(scaled).astype(np.int64)
    key = (cell[:, 0] * resolution + cell[:, 1]) * resolution + cell[:, 2]
    unique, which, count = np.unique(key, return_inverse=True, return_counts=True)
    offset = scaled - cell - 0.5
    octant = ((offset > 0) * [4, 2, 1]).sum(axis=1)
    total = np.zeros((len(unique), 17))
    np.add.at(total[:, :9], which, np.hstack([2 * colours - 1, normals, offset]))
    total[which, 9 + octant] = 1
    total[:, :9] /= count[:, None]
    kept = count >= least
    unique, total = unique[kept], total[kept]
    coords = np.stack(
        [unique // resolution**2, unique // resolution % resolution, unique % resolution], axis=1
    )
    return coords.astype(np.uint8), total.astype(np.float16)
