"""All views of one synthetic vehicle."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from recast.geometry import PinholeCamera, se3
from recast.recar.camera import camera_pose, fitting_distance, pinhole
from recast.recar.picture import Image
from recast.recar.record import IdentityRecord, SetRecord
from recast.recar.synthesis_plan import PlannedIdentity, SynthesisSettings
from recast.synthetic.rendering import RayScene, render_camera
from recast.synthetic.surface import concatenate
from recast.synthetic.vehicles import read_mesh, sample_shape, sample_vehicle
from recast.synthetic.world import Sky, VehicleModel

Array = NDArray[np.float64]

_SHAPE, _LIGHT, _VIEWS = 0, 1, 2  # random streams of one identity


def make_model(planned: PlannedIdentity, settings: SynthesisSettings) -> VehicleModel:
    """The shape of a planned identity.

    Raises:
        InputError: its mesh file cannot be used.
    """
    if planned.mesh is not None:
        forward, up = planned.mesh_axes.split(",")
        return read_mesh(planned.mesh, forward=forward, up=up)
    rng = np.random.default_rng([*planned.seed, _SHAPE])
    if planned.group == "shape":
        return sample_shape(rng)
    kinds = settings.kinds
    return sample_vehicle(rng, kinds[int(rng.integers(len(kinds)))] if kinds else None)


def studio_sky(rng: np.random.Generator) -> Sky:
    """Soft daylight: a high, large, weak sun somewhere around the vehicle, and a bright sky."""
    azimuth = rng.uniform(0, 2 * np.pi)
    elevation = np.radians(rng.uniform(40, 65))
    strength = rng.uniform(1.0, 2.0)
    warmth = rng.uniform(-0.04, 0.04)
    return Sky(
        sun_direction=np.array(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ]
        ),
        sun=strength * np.array([1.0 + warmth, 1.0, 1.0 - warmth]),
        zenith=np.array([0.62, 0.66, 0.72]),
        horizon=np.array([0.70, 0.71, 0.73]),
        sun_radius=0.15,
        clouds=0.0,
        seed=int(rng.integers(2**31)),
    )


def identity_record(
    planned: PlannedIdentity, model: VehicleModel, record: SetRecord
) -> IdentityRecord:
    """What identity.json says about a model, the distance of its cameras included."""
    assert record.fov_deg is not None and record.elevation_deg is not None
    # Mirrors reach beyond the box; the cameras look at the centre of the box nonetheless.
    reach = 2 * np.abs(model.surface.bounds()).max(axis=0)
    camera = pinhole(record.width, record.height, record.fov_deg)
    distance = fitting_distance(np.maximum(reach, model.size), camera, record.elevation_deg)
    length, width, height = (round(float(metres), 4) for metres in model.size)
    return IdentityRecord(
        id=planned.id,
        kind=model.kind,
        category=model.category,
        colour=model.colour if planned.mesh is None else None,
        size=(length, width, height),
        distance_m=round(distance, 4),
        split=planned.split,
        source=None if planned.mesh is None else planned.mesh.name,
        seed=planned.seed,
    )


def render_views(
    model: VehicleModel, identity: IdentityRecord, record: SetRecord
) -> Iterator[Image]:
    """The pictures of a model, (height, width, 4) uint8 RGBA with straight alpha, in order.

    Raises:
        InputError: embreex is not installed.
    """
    assert identity.seed is not None and identity.distance_m is not None
    assert record.fov_deg is not None and record.elevation_deg is not None
    scene = RayScene(concatenate([]), {"vehicle": model.surface})
    sky = studio_sky(np.random.default_rng([*identity.seed, _LIGHT]))
    camera = pinhole(record.width, record.height, record.fov_deg)
    for index, azimuth in enumerate(record.azimuths_deg):
        pose = camera_pose(azimuth, record.elevation_deg, identity.distance_m)
        left, top, right, bottom = _rectangle(model, camera, pose)
        # Two pixels in three show nothing; not casting their rays saves a third of the time.
        frame = render_camera(
            scene,
            sky,
            camera.cropped(left, top, right - left, bottom - top),
            pose,
            {"vehicle": np.eye(4)},
            rng=np.random.default_rng([*identity.seed, _VIEWS, index]),
        )
        picture = np.zeros((record.height, record.width, 4), np.uint8)
        picture[top:bottom, left:right, :3] = frame.rgb
        picture[top:bottom, left:right, 3] = np.round(255 * frame.alpha)
        yield picture


def _rectangle(
    model: VehicleModel, camera: PinholeCamera, actor_from_camera: Array
) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of the pixels that can show the model."""
    points = se3.apply(se3.inverse(actor_from_camera), model.surface.vertices)
    pixels, _ = camera.project(points)
    left, top = np.maximum(np.floor(pixels.min(axis=0)).astype(int), 0)
    right, bottom = np.ceil(pixels.max(axis=0)).astype(int)
    return int(left), int(top), min(int(right), camera.width), min(int(bottom), camera.height)
