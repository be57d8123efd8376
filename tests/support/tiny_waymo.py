"""A small Waymo segment in the dataset's own layout, written from nothing.

The ego drives 30 degrees north of east, far from the origin, at 10 m/s, turning left slowly. A car
ahead to the left drives the other way. There is the ground, at the vehicle's own height, and
a wall; the LiDARs see these two, ray by ray, each at the time at which it looks there.
"""

from __future__ import annotations

import io
import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

from recast.geometry import se3
from support.proto_writer import (
    blob,
    double,
    doubles,
    integer,
    packed_doubles,
    packed_integers,
    write_records,
)

NAME = "12345_1000_000_1020_000"
FILE = f"segment-{NAME}_with_camera_labels.tfrecord"
START_US, FRAME_US, TURN_US = 1_550_000_000_000_000, 100_000, 100_000
SPEED, YAW_RATE = 10.0, 0.1
FAR = np.array([1200.0, -3400.0, 30.0])
WALL = 40.0
"""Metres ahead of the start, across the road: a plane in the street's frame."""
GLOBAL_FROM_STREET = se3.from_rotation_translation(se3.rotation_z(np.radians(30.0)), FAR)
CAR_SIZE = np.array([4.4, 1.9, 1.6])
WIDTH, HEIGHT = 48, 32
INTRINSIC = (40.0, 41.0, 24.5, 15.5, 0.04, -0.3, 0.001, -0.002, 0.01)
CAMERAS = {
    "FRONT": (1, 0),
    "FRONT_LEFT": (2, 45),
    "FRONT_RIGHT": (3, -45),
    "SIDE_LEFT": (4, 90),
    "SIDE_RIGHT": (5, -90),
}
"""Number and azimuth in degrees."""
TOP = se3.from_rotation_translation(se3.rotation_z(np.radians(148.0)), [1.43, 0.0, 2.18])
REAR = se3.from_rotation_translation(se3.rotation_z(np.radians(-179.0)), [-1.2, 0.1, 0.9])
BEAMS = np.radians([-25.0, -16.0, -9.0, -5.0, -2.0, 2.0])
COLUMNS = 40
MAP_OFFSET = np.array([0.4, -0.3, 0.2])


def street_from_vehicle(seconds: float) -> np.ndarray:
    """True pose at a time after START_US: an arc."""
    turned, radius = YAW_RATE * seconds, SPEED / YAW_RATE
    place = [radius * math.sin(turned), radius * (1 - math.cos(turned)), 0.0]
    return se3.from_rotation_translation(se3.rotation_z(turned), place)


def global_from_vehicle(seconds: float) -> np.ndarray:
    return GLOBAL_FROM_STREET @ street_from_vehicle(seconds)


def global_from_car(seconds: float) -> np.ndarray:
    pose = se3.from_rotation_translation(
        se3.rotation_z(np.pi - 0.1), [30.0 - 8.0 * seconds, 4.0, CAR_SIZE[2] / 2]
    )
    return GLOBAL_FROM_STREET @ pose


def scan_seconds(azimuth: float, frame: int) -> float:
    """When the scanner, turning clockwise from the rear, looks in a direction."""
    return frame * FRAME_US / 1e6 + (math.pi - azimuth) / math.tau * TURN_US / 1e6


def image_seconds(camera: str, frame: int) -> float:
    return scan_seconds(math.radians(CAMERAS[camera][1]), frame) + 0.002


def transform(pose: np.ndarray, packed: bool = False) -> bytes:
    return (packed_doubles if packed else doubles)(1, pose.ravel().tolist())


def matrix(values: np.ndarray) -> bytes:
    """A compressed MatrixFloat."""
    shape = packed_integers(1, values.shape)
    return zlib.compress(blob(1, values.astype("<f4").tobytes()) + blob(2, shape))


@dataclass
class Parts:
    """What a test may change before the segment is written; by default nothing."""

    frames: int = 3
    frame: Callable[[int, bytes], bytes] = lambda number, data: data
    calibration: Callable[[str, bytes], bytes] = lambda name, data: data
    label: Callable[[int, str], bytes] = lambda frame, name: label(frame, name)
    range_image: Callable[[int, str, bytes], bytes] = lambda frame, name, data: data
    jpeg: Callable[[int, str, bytes], bytes] = lambda frame, name, data: data
    features: list[bytes] | None = None
    lasers: bool = True
    second: bool = True
    missing: set[str] = field(default_factory=set)


def write_segment(root: Path, parts: Parts | None = None) -> Path:
    """Write the segment under `root`; returns its file."""
    parts = parts or Parts()
    frames = [parts.frame(k, frame_bytes(k, parts)) for k in range(parts.frames)]
    write_records(root / FILE, frames)
    return root / FILE


def frame_bytes(k: int, parts: Parts) -> bytes:
    pose = global_from_vehicle(image_seconds("FRONT", k))
    out = [blob(1, context(parts)), integer(2, START_US + k * FRAME_US), blob(3, transform(pose))]
    for name in ("FRONT", "FRONT_LEFT", "SIDE_LEFT", "FRONT_RIGHT", "SIDE_RIGHT"):
        out.append(blob(4, image_bytes(k, name, parts)))
    for name in ("TOP", "REAR") if parts.lasers else ():
        out.append(blob(5, laser_bytes(k, name, parts)))
    if not parts.lasers:
        out += [blob(5, b"")] * 5
    out += [blob(6, parts.label(k, name)) for name in ("car", "sign")]
    if k == 0:
        features = map_features() if parts.features is None else parts.features
        out += [blob(10, feature) for feature in features]
    offset = b"".join(double(i + 1, v) for i, v in enumerate(MAP_OFFSET))
    return b"".join([*out, blob(11, offset), blob(500, b"a field of a later version")])


def context(parts: Parts) -> bytes:
    cameras = []
    for name, (number, azimuth) in reversed(CAMERAS.items()):
        mount = se3.from_rotation_translation(se3.rotation_z(math.radians(azimuth)), [1.5, 0, 2.1])
        data = (
            integer(1, number)
            + doubles(2, INTRINSIC)
            + blob(3, transform(mount))
            + integer(4, WIDTH)
            + integer(5, HEIGHT)
            + integer(6, 2)
        )
        if name not in parts.missing:
            cameras.append(blob(2, parts.calibration(name, data)))
    top = integer(1, 1) + doubles(2, BEAMS) + blob(5, transform(TOP, packed=True))
    rear = integer(1, 5) + double(3, -1.5) + double(4, 0.5) + blob(5, transform(REAR))
    lasers = [
        blob(3, data) for name, data in (("REAR", rear), ("TOP", top)) if name not in parts.missing
    ]
    stats = blob(2, "Day") + blob(3, "location_sf") + blob(4, "sunny")
    return b"".join([blob(1, NAME), *cameras, *lasers, blob(4, stats)])


def picture(k: int, name: str) -> bytes:
    buffer = io.BytesIO()
    Image.new("RGB", (WIDTH, HEIGHT), (40 * k, 30 * CAMERAS[name][0], 90)).save(buffer, "JPEG")
    return buffer.getvalue()


def image_bytes(k: int, name: str, parts: Parts) -> bytes:
    seconds = image_seconds(name, k)
    absolute = START_US / 1e6 + seconds
    return (
        integer(1, CAMERAS[name][0])
        + blob(2, parts.jpeg(k, name, picture(k, name)))
        + blob(3, transform(global_from_vehicle(seconds)))
        + double(5, absolute)
        + double(6, 0.004)
        + double(7, absolute - 0.026)
        + double(8, absolute + 0.022)
    )


def beam_angles(name: str) -> np.ndarray:
    """Inclinations by row, the highest first."""
    rows = 5
    even = [-1.5 + (rows - i - 0.5) / rows * 2.0 for i in range(rows)]
    return BEAMS[::-1] if name == "TOP" else np.array(even)


def range_images(k: int, name: str) -> tuple[np.ndarray, np.ndarray]:
    """What the LiDAR measures, (H, W, 4), and the vehicle's pose at each pixel (H, W, 6).

    Every pixel looks at its own time at TOP, and all at the frame's pose at the others.
    """
    angles, mount = beam_angles(name), TOP if name == "TOP" else REAR
    image = np.zeros((len(angles), COLUMNS, 4))
    poses = np.zeros((len(angles), COLUMNS, 6))
    for column in range(COLUMNS):
        azimuth = math.pi * (1 - 2 * (column + 0.5) / COLUMNS)
        rear_seconds = image_seconds("FRONT", k)
        seconds = scan_seconds(azimuth, k) if name == "TOP" else rear_seconds
        vehicle = street_from_vehicle(seconds)
        yaw = math.radians(30.0) + YAW_RATE * seconds
        in_global = GLOBAL_FROM_STREET @ vehicle
        # The direction of the column in the vehicle frame, then in the scanner's own.
        own = azimuth - math.atan2(mount[1, 0], mount[0, 0])
        for row, inclination in enumerate(angles):
            flat = math.cos(inclination)
            ray = [flat * math.cos(own), flat * math.sin(own), math.sin(inclination)]
            ahead = (vehicle @ mount)[:3, :3] @ ray
            start = (vehicle @ mount)[:3, 3]
            hits = [-start[2] / ahead[2]] if ahead[2] < -1e-9 else []
            if ahead[0] > 1e-9:
                hits.append((WALL - start[0]) / ahead[0])
            poses[row, column] = [0.0, 0.0, yaw, *in_global[:3, 3]]
            if hits and min(hits) < 70.0:
                image[row, column] = [min(hits), 0.5 * (row + 1), 0.0, -1.0]
            else:
                image[row, column, 0] = -1.0
    return image, poses


def second_return(image: np.ndarray) -> np.ndarray:
    """Of what is far away, brighter."""
    return np.where(image[..., :1] > 30.0, image + np.array([0, 3, 0, 0]), [-1.0, 0, 0, 0])


def laser_bytes(k: int, name: str, parts: Parts) -> bytes:
    image, poses = range_images(k, name)
    second = second_return(image)
    first = blob(2, parts.range_image(k, name, matrix(image)))
    if name == "TOP":
        first += blob(4, matrix(poses))
    number = 1 if name == "TOP" else 5
    more = blob(3, blob(2, matrix(second))) if parts.second else b""
    return integer(1, number) + blob(2, first) + more


KINDS = {"car": 1, "sign": 3}


def box_values(k: int, name: str) -> dict[str, float]:
    """A box as it is drawn: on the points of the turn, seen from the frame's pose."""
    vehicle_from_global = se3.inverse(global_from_vehicle(image_seconds("FRONT", k)))
    size = CAR_SIZE if name == "car" else np.array([0.1, 0.6, 0.6])
    pose = vehicle_from_global @ GLOBAL_FROM_STREET
    pose = pose @ se3.from_rotation_translation(np.eye(3), [12.0, -6.0, 2.0])
    for _ in range(20 if name == "car" else 0):
        azimuth = math.atan2(pose[1, 3], pose[0, 3])
        pose = vehicle_from_global @ global_from_car(scan_seconds(azimuth, k))
    return dict(
        zip(
            ("cx", "cy", "cz", "width", "length", "height"),
            (*pose[:3, 3], size[1], size[0], size[2]),
            strict=True,
        ),
        heading=float(se3.yaw(pose)),
    )


def label(k: int, name: str, kind: int | None = None, **changes: float) -> bytes:
    values = box_values(k, name) | changes
    box = b"".join(double(i + 1, value) for i, value in enumerate(values.values()))
    return blob(1, box) + integer(3, KINDS[name] if kind is None else kind) + blob(4, name)


def in_map(points: list[tuple[float, float]]) -> list[bytes]:
    """MapPoint messages of places in the street."""
    street = np.array([(x, y, 0.0) for x, y in points])
    placed = se3.apply(GLOBAL_FROM_STREET, street) + MAP_OFFSET
    return [b"".join(double(i + 1, v) for i, v in enumerate(row)) for row in placed]


def line(start: tuple[float, float], end: tuple[float, float], count: int = 11) -> list:
    return [tuple(row) for row in np.linspace(start, end, count)]


def lane(key: int, points: list, *more: bytes, mph: float = 25.0, kind: int = 2) -> bytes:
    data = double(1, mph) + integer(2, kind) + b"".join(blob(8, p) for p in in_map(points))
    return integer(1, key) + blob(3, data + b"".join(more))


def boundary(number: int, feature: int, first: int = 0, last: int = 10) -> bytes:
    return blob(number, integer(1, first) + integer(2, last) + integer(3, feature))


def neighbour(number: int, key: int, first: int, last: int) -> bytes:
    return blob(number, integer(1, key) + integer(2, first) + integer(3, last))


def map_features() -> list[bytes]:
    """The ego's lane 1 leads to 2; left of it 3, right of it a bicycle lane 4 and a kerb."""

    def polyline(points: list) -> bytes:
        return integer(1, 1) + b"".join(blob(2, p) for p in in_map(points))

    driveway = b"".join(blob(1, p) for p in in_map([(20, -6), (24, -6), (24, -12), (20, -12)]))
    return [
        lane(
            1,
            line((-20, 0), (30, 0)),
            packed_integers(10, [2, 77]),
            neighbour(11, 3, 0, 10),
            neighbour(11, 77, 0, 10),
            neighbour(12, 4, 0, 10),
            boundary(13, 11),
            boundary(14, 12, 0, 5),
        ),
        lane(2, line((30, 0), (60, 0)), integer(3, 1), mph=0.0),
        lane(
            3,
            line((-20, 3.4), (30, 3.4)),
            neighbour(12, 2, 0, 2),
            neighbour(12, 1, 0, 10),
            boundary(14, 11),
        ),
        lane(4, line((-20, -2.6), (30, -2.6)), kind=3),
        lane(5, [(0.0, 0.0)]),
        integer(1, 11) + blob(4, polyline(line((-20, 1.6), (30, 1.6), 3))),
        integer(1, 12) + blob(4, polyline(line((-20, -1.8), (30, -1.8), 3))),
        integer(1, 13) + blob(5, polyline(line((-30, -6), (70, -6), 3))),
        integer(1, 14) + blob(10, driveway),
        integer(1, 15) + blob(9, b"".join(blob(1, p) for p in in_map([(1, 1), (2, 1), (2, 2)]))),
    ]
