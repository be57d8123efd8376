"""The sensors of the synthetic car, and the truth that they leave beside a log.

Three cameras and a roof LiDAR, placed much as on Waymo's. What a log cannot hold lies in its folder
`truth`, exact depth and whose every pixel is: truth.json, and for each camera and frame
`CAMERA/depth_NNNN.npz` (member "depth", float32 metres along the camera's z axis, infinite where
the sky is) and `CAMERA/instance_NNNN.png` (16 bit: 0 street, 65535 sky, others as
`TruthRecord.instances` says).
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from pydantic import BaseModel, ConfigDict

from recast.arrays import Array, Float32Array
from recast.cameras import PinholeCamera
from recast.core import files, records
from recast.core.errors import InputError
from recast.core.images import decode_image
from recast.geometry import se3

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
TRUTH_FOLDER = "truth"
TRUTH_RECORD = "truth.json"
_TRUTH_VERSION = 1


@dataclass(frozen=True)
class RigCamera:
    """One camera."""

    camera: PinholeCamera  # intrinsics, without distortion
    rig_from_camera: Array  # (4, 4) OpenCV camera frame to rig


@dataclass(frozen=True)
class Rig:
    """All sensors."""

    cameras: Mapping[str, RigCamera]  # cameras by name
    rig_from_lidar: Array  # (4, 4) pose of the sensor `LIDAR`, which looks along the rig's x axis


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
            mend = f"choose {_LEAST_SIDE} to {_GREATEST_SIDE}"
            raise InputError("image size", field, f"{value} pixels is impossible", mend)
    names = CAMERAS if cameras is None else tuple(cameras)
    for name in names:
        if name not in _CAMERA_PLACES:
            choice = f"choose one of {', '.join(CAMERAS)}"
            raise InputError("rig", f"camera {name}", "does not exist", choice)
    if not names or len(set(names)) < len(names):
        problem = "names no camera" if not names else f"names a camera twice: {', '.join(names)}"
        raise InputError("rig", "cameras", problem, f"choose one of {', '.join(CAMERAS)}")
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


class TruthRecord(BaseModel):
    """The contents of truth.json.

    Attributes:
        frames: number of frames by camera.
        instances: track id by the value of its pixels.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    format: Literal["recast-truth"] = "recast-truth"
    version: Literal[1] = 1
    street: Literal[0] = 0
    sky: Literal[65535] = 65535
    frames: dict[str, int]
    instances: dict[int, str]


@dataclass(frozen=True)
class Truth:
    """Reads the folder; frames are decoded when asked for."""

    folder: Path  # folder of truth.json
    record: TruthRecord  # its contents

    def depth(self, camera: str, frame: int) -> NDArray[np.float32]:
        """(height, width) metres along z, infinite where the sky is."""
        self._check(camera, frame)
        with np.load(depth_file(self.folder, camera, frame), allow_pickle=False) as archive:
            depth: NDArray[np.float32] = archive["depth"]
        return depth

    def instance(self, camera: str, frame: int) -> NDArray[np.uint16]:
        """(height, width) whose each pixel is."""
        self._check(camera, frame)
        path = instance_file(self.folder, camera, frame)
        return decode_image(path, path, ("PNG",)).astype(np.uint16)

    def _check(self, camera: str, frame: int) -> None:
        count = self.record.frames.get(camera, 0)
        if not 0 <= frame < count:
            known = ", ".join(f"{key} 0-{n - 1}" for key, n in self.record.frames.items())
            raise InputError(
                self.folder, f"{camera} frame {frame}", "is missing", f"choose one of {known}"
            )


def read_truth(log_folder: str | Path) -> Truth:
    """The truth beside a log.

    Raises:
        InputError: there is none, or truth.json is broken or of another version.
    """
    folder = Path(log_folder) / TRUTH_FOLDER
    mend = "make the log again: recast log synth --truth"
    if not (folder / TRUTH_RECORD).is_file():
        raise InputError(folder, TRUTH_RECORD, "is missing", mend)
    record = records.read_record(
        folder / TRUTH_RECORD, TruthRecord, _TRUTH_VERSION, mend, "recast-truth"
    )
    return Truth(folder, record)


def write_truth_record(folder: Path, record: TruthRecord) -> None:
    """Write truth.json into `folder`."""
    files.write_json(folder / TRUTH_RECORD, record.model_dump())


def write_truth_frame(
    folder: Path, camera: str, frame: int, depth: Float32Array, instance: NDArray[np.uint16]
) -> None:
    """Write the two files of a frame."""
    path = depth_file(folder, camera, frame)
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, depth=depth.astype(np.float32))
    PillowImage.fromarray(instance.astype(np.uint16)).save(instance_file(folder, camera, frame))


def depth_file(folder: Path, camera: str, frame: int) -> Path:
    """Path of a depth map."""
    return folder / camera / f"depth_{frame:04d}.npz"


def instance_file(folder: Path, camera: str, frame: int) -> Path:
    """Path of an instance mask."""
    return folder / camera / f"instance_{frame:04d}.png"
