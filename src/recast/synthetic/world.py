"""The whole of a synthetic drive, street, light, vehicles and ego; and the sensors of its car.

Three cameras and a roof LiDAR, placed much as on Waymo's. What a log cannot hold lies in its folder
`truth`, exact depth and whose every pixel is: truth.json, and for each camera and frame
`CAMERA/depth_NNNN.npz` (member "depth", float32 metres along the camera's z axis, infinite where
the sky is) and `CAMERA/instance_NNNN.png` (16 bit: 0 street, 65535 sky, others as
`TruthRecord.instances` says).
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
import shapely
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray
from PIL import Image as PillowImage
from pydantic import BaseModel, ConfigDict

from recast.arrays import Array, Float32Array
from recast.cameras import PinholeCamera
from recast.core import files, records
from recast.core.errors import InputError
from recast.core.images import decode_image
from recast.geometry import Polyline, boxes, se2, se3
from recast.logs import HdMap, Trajectory
from recast.synthetic.surface import Surface

Quality = Literal["standard", "mitsuba"]
"""Where the light of the sky comes from: one bounce of our own, or mitsuba's path tracer."""
Conditions = Literal[
    "fair", "overcast", "low-sun", "dusk", "underexposed", "overexposed", "varying-exposure"
]
"""Light of the day, or how the cameras are exposed to it."""
Times = NDArray[np.bool_]


@dataclass(frozen=True)
class Sky:
    """Daylight."""

    sun_direction: Array  # (3,) unit vector towards the sun, world frame
    sun: Array  # (3,) linear RGB irradiance on a surface that faces the sun
    # zenith, horizon: (3,) linear RGB radiance of the sky overhead and at the horizon.
    zenith: Array
    horizon: Array
    sun_radius: float = 0.01  # radius, in radians, of the disc that casts soft shadows
    clouds: float = 0.3  # cloud cover in [0, 1]
    seed: int = 0  # seed of the cloud pattern


@dataclass(frozen=True)
class ParkingSpot:
    """Where a car may stand."""

    # x, y, heading: place and heading of the box centre, world frame, metres and radians.
    x: float
    y: float
    heading: float
    length: float = 5.2  # metres that a vehicle there may have


@dataclass(frozen=True)
class Street:
    """Everything that never moves."""

    kind: str  # name of the scene, such as "urban-straight"
    surface: Surface  # triangles in the world frame, ground at z = 0 on the road
    map: HdMap  # lanes, drivable area, ground
    ego_route: tuple[str, ...]  # lane ids in the order of driving
    ego_speed: float  # m/s that the ego keeps on a free road
    parking: tuple[ParkingSpot, ...]  # spots for parked cars
    sky: Sky  # daylight


class Articulation(Protocol):
    """How a shape changes with the way that it has gone: legs that walk, wheels that turn."""

    def surface_at(self, travelled: float) -> Surface:
        """Triangles in the actor-local frame after `travelled` metres, always the same number."""


@dataclass(frozen=True)
class VehicleModel:
    """One vehicle or person as a shape."""

    # "hatchback", "sedan", "estate", "suv", "pickup", "van", "box-truck" or "bus"; "pedestrian" or
    # "cyclist".
    kind: str
    category: str  # category of the label, see `recast.logs.Track`
    colour: str  # name, such as "white"
    size: Array  # (3,) length, width, height of the box around it, metres; mirrors not counted
    # triangles in the actor-local frame: origin at the box centre, x forward, y left, z up, the
    # tyres or feet standing on z = -height / 2.
    surface: Surface
    # how the surface changes with the way; None for a rigid vehicle.
    articulation: Articulation | None = None


@dataclass(frozen=True)
class Vehicle:
    """One vehicle or person in the world."""

    track_id: str  # track id, unique in the world
    model: VehicleModel  # its shape
    trajectory: Trajectory  # `world_from_actor` at the times of the log
    parked: bool  # never moves in the log

    def surface_at(self, pose: Array) -> Surface:
        """Triangles in the actor-local frame when it is at `pose` (4, 4) `world_from_actor`.

        What is articulated has the shape of the metres that it has gone, see `Polyline.gone`.
        """
        if self.model.articulation is None:
            return self.model.surface
        return self.model.articulation.surface_at(self._way.gone(se2.from_se3(pose)))

    @cached_property
    def _way(self) -> Polyline:
        return Polyline.from_points(self.trajectory.poses[:, :2, 3])


@dataclass(frozen=True)
class World:
    """A drive that can be looked at from anywhere.

    Attributes:
        name, seed, seconds, people: give this world again, see `make_world`.
        street: what never moves.
        vehicles: vehicles and people by track id, the ego not among them.
        ego: `world_from_rig`.
        target: track id of the vehicle that the scene was made to ask about.
        light: how cameras are lit, in the log and by the oracle.
        people: whether pedestrians and cyclists are among the vehicles.
        conditions: light of the day, which `street.sky` has, and exposure of the cameras.
    """

    name: str
    seed: int
    seconds: float
    street: Street
    vehicles: Mapping[str, Vehicle]
    ego: Trajectory
    target: str
    light: Quality = "standard"
    people: bool = False
    conditions: Conditions = "fair"

    def exposure(self, camera: str, timestamp_us: int | None = None) -> float:
        """How much brighter than right a camera's images are, at no time of the log (None) as on
        average."""
        factor = _EXPOSED.get(self.conditions, 1.0)
        if self.conditions == "varying-exposure" and timestamp_us is not None:
            seconds = (timestamp_us - int(self.ego.timestamps_us[0])) / 1e6
            factor = float(2 ** (_VARIES_STOPS * np.sin(2 * np.pi * seconds / _VARIES_S)))
        return factor * exposure(self.seed, camera)


def touching(
    poses_a: Array, size_a: ArrayLike, poses_b: Array, size_b: ArrayLike, margin: float = 0.0
) -> Times:
    """At which times (T,) two rectangles come closer than about `margin` metres.

    They are given by planar poses (T, 3) of their centres and (length, width) in metres.
    """
    grown_a, grown_b = (np.asarray(s, np.float64)[:2] + margin for s in (size_a, size_b))
    return boxes.bev_touching(poses_a, grown_a, poses_b, grown_b)


def hiding(
    eyes: Array, target: Array, target_size: ArrayLike, other: Array, other_size: ArrayLike
) -> Times:
    """At which times (T,) `other` cuts a sight line from `eyes` (T, 2) to the target's box."""
    outline, wall = (
        boxes.bev_corners(poses, *np.asarray(size, np.float64)[:2])
        for poses, size in ((target, target_size), (other, other_size))
    )
    ends = np.concatenate([outline, target[:, None, :2]], axis=1)
    sight = shapely.linestrings(np.stack(np.broadcast_arrays(eyes[:, None], ends), axis=2))
    return np.any(shapely.intersects(sight, shapely.polygons(wall)[:, None]), axis=1)


def daylight(rng: Generator, elevation: tuple[float, float] = (25.0, 60.0)) -> Sky:
    """A sky drawn from fair to overcast; the lower the sun, the warmer and weaker its light.

    Args:
        rng: source of the draw.
        elevation: degrees between which the sun stands.
    """
    azimuth = rng.uniform(0.0, 2 * np.pi)
    high = np.deg2rad(rng.uniform(*elevation))
    clouds = float(rng.choice([rng.uniform(0.05, 0.35), rng.uniform(0.35, 0.75)], p=[0.65, 0.35]))
    haze = rng.uniform(0.0, 1.0)
    direction = se3.direction(azimuth, high)
    low = np.exp(-np.sin(high) / 0.35)  # path through the air
    strength = (1 - 0.55 * clouds**2) * (1 - 0.15 * haze)
    sun = strength * 5.0 * np.array([1.0, 1.0 - 0.16 * low, 0.94 - 0.42 * low]) * (1 - 0.3 * low)
    grey = np.array([0.62, 0.66, 0.72])
    clear = np.array([0.23, 0.36, 0.62])
    zenith = (1 - 0.6 * clouds) * clear + 0.6 * clouds * grey
    pale = np.array([0.66, 0.76, 0.88])
    horizon = (1 - 0.5 * haze) * pale + 0.5 * haze * np.array([0.85, 0.85, 0.84])
    return Sky(
        sun_direction=direction,
        sun=sun,
        zenith=zenith,
        horizon=horizon,
        sun_radius=float(0.006 + 0.03 * clouds),
        clouds=clouds,
        seed=int(rng.integers(2**31)),
    )


def in_conditions(sky: Sky, conditions: Conditions, heading: float) -> Sky:
    """The sky of a fair day in other light.

    Overcast: hardly any sun. Low sun: 8 degrees high, 20 degrees beside the way of the ego. Dusk:
    no sun, a blue sky that is bright and red in one direction only.

    Args:
        heading: direction in which the ego sets out, radians.
    """
    grey = np.array([0.60, 0.63, 0.67])
    match conditions:
        case "overcast":
            return replace(
                sky,
                sun=0.02 * sky.sun,
                sun_radius=0.06,
                zenith=grey,
                horizon=1.05 * grey,
                clouds=1.0,
            )
        case "low-sun":
            towards = se3.direction(heading + np.deg2rad(20.0), np.deg2rad(8.0))
            sun = np.array([3.2, 2.3, 1.3])
            return replace(
                sky, sun_direction=towards, sun=sun, horizon=np.array([0.95, 0.82, 0.62])
            )
        case "dusk":
            after = se3.direction(heading + np.deg2rad(50.0), np.deg2rad(2.0))
            return replace(
                sky,
                sun_direction=after,
                sun=np.array([0.10, 0.05, 0.03]),
                sun_radius=0.1,
                zenith=np.array([0.05, 0.07, 0.14]),
                horizon=np.array([0.20, 0.16, 0.17]),
            )
        case _:
            return sky


RATE_HZ = 10
"""Rate of every camera and of the LiDAR, which fire together."""
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


_EXPOSED = {"dusk": 0.5, "underexposed": 0.45, "overexposed": 1.9}
"""Factor on the exposure that is right for a white surface."""
_VARIES_STOPS, _VARIES_S = 0.5, 5.0
"""By how many stops, and in how many seconds, an exposure that varies rises and falls."""


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
