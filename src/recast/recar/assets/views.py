"""Where the cameras of a training asset stand: some as on a car, some all around."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.recar.camera import camera_pose, fitting_distance, pinhole

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AssetView:
    """One camera.

    Attributes:
        focal: pixels.
        pose: (4, 4) `asset_from_camera`, unit cube.
    """

    focal: float
    pose: Array


def sample_views(
    rng: np.random.Generator, extents: Array, crops: int, around: int, pixels: int
) -> list[AssetView]:
    """Cameras that see the whole asset, azimuths spread evenly with a random start.

    Args:
        extents: (3,) of the asset in the unit cube.
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
