"""The sensors of the synthetic car: three cameras and a roof LiDAR, placed much as on Waymo's."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.geometry import PinholeCamera, se3

Array = NDArray[np.float64]

RATE_HZ = 10
"""Of every camera and of the LiDAR, which fire together."""
LIDAR = "lidar_top"

_HORIZONTAL_FIELD = np.deg2rad(50.4)
_CAMERA_PLACES: Mapping[str, tuple[tuple[float, float, float], float]] = {
    "front_left": ((1.49, 0.10, 2.12), np.deg2rad(45.0)),
    "front": ((1.54, 0.0, 2.12), 0.0),
    "front_right": ((1.49, -0.10, 2.12), np.deg2rad(-45.0)),
}
"""Position in the rig frame, metres, and yaw to the left."""
_LIDAR_PLACE = (1.43, 0.0, 2.18)
_RIG_FROM_FORWARD_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_LEAST_SIDE, _GREATEST_SIDE = 16, 8192
_EXPOSURE_SPREAD = 0.03
_EXPOSURE_STREAM = 501

CAMERAS: tuple[str, ...] = tuple(_CAMERA_PLACES)


@dataclass(frozen=True)
class RigCamera:
    """One camera.

    Attributes:
        camera: intrinsics, without distortion.
        rig_from_camera: (4, 4) OpenCV camera frame to rig.
    """

    camera: PinholeCamera
    rig_from_camera: Array


@dataclass(frozen=True)
class Rig:
    """All sensors.

    Attributes:
        cameras: by name.
        rig_from_lidar: (4, 4) of the sensor `LIDAR`, which looks along the rig's x axis.
    """

    cameras: Mapping[str, RigCamera]
    rig_from_lidar: Array


def make_rig(width: int = 480, height: int = 320, cameras: tuple[str, ...] | None = None) -> Rig:
    """The rig with images of a given size.

    The horizontal field of view is 50.4 degrees at any size and pixels are square.

    Args:
        width, height: pixels, 16 to 8192.
        cameras: names out of `CAMERAS`, None for all.

    Raises:
        InputError: a size is impossible, or no camera has that name.
    """
    for field, value in (("width", width), ("height", height)):
        if not _LEAST_SIDE <= value <= _GREATEST_SIDE:
            raise InputError(
                "image size",
                field,
                f"{value} pixels is impossible",
                f"choose {_LEAST_SIDE} to {_GREATEST_SIDE}",
            )
    names = CAMERAS if cameras is None else tuple(cameras)
    for name in names:
        if name not in _CAMERA_PLACES:
            choice = f"choose of {', '.join(CAMERAS)}"
            raise InputError("rig", f"camera {name}", "does not exist", choice)
    if not names or len(set(names)) < len(names):
        problem = "names none" if not names else f"names one twice: {', '.join(names)}"
        raise InputError("rig", "cameras", problem, f"choose of {', '.join(CAMERAS)}")
    focal = width / (2 * np.tan(_HORIZONTAL_FIELD / 2))
    camera = PinholeCamera(width, height, focal, focal, width / 2, height / 2)
    rig_from_lidar = se3.from_rotation_translation(np.eye(3), np.array(_LIDAR_PLACE))
    return Rig({name: RigCamera(camera, _mount(name)) for name in names}, rig_from_lidar)


def _mount(name: str) -> Array:
    place, yaw = _CAMERA_PLACES[name]
    rotation = se3.rotation_z(yaw) @ _RIG_FROM_FORWARD_CAMERA
    return se3.from_rotation_translation(rotation, np.array(place))


def exposure(seed: int, camera: str) -> float:
    """How much brighter than right a camera of the world with `seed` is, 0.97 to 1.03."""
    rng = np.random.default_rng([seed, _EXPOSURE_STREAM, sensor_number(camera)])
    return float(rng.uniform(1 - _EXPOSURE_SPREAD, 1 + _EXPOSURE_SPREAD))


def sensor_number(name: str) -> int:
    """A number for seeding that depends on the sensor's name alone."""
    return zlib.crc32(name.encode())
