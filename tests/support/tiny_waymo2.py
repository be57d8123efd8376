"""The drive of `tiny_waymo` in the layout of Waymo v2: one parquet file for each component.

Columns, their order and their types are those of the dataset's own schemas.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from recast.geometry import se3
from support import tiny_waymo as tiny

LASERS = {"TOP": 1, "REAR": 5}
FRAMES = 3
FRAME, CAMERA, LASER = "frame_timestamp_micros", "camera_name", "laser_name"
DOUBLE, BYTE, INT = pa.float64(), pa.int8(), pa.int32()
TRANSFORM, MATRIX = (
    pa.list_(DOUBLE, 16),
    {"values": pa.list_(pa.float32()), "shape": pa.list_(INT, 3)},
)
KEYS = {
    "segment_context_name": pa.string(),
    FRAME: pa.int64(),
    CAMERA: BYTE,
    LASER: BYTE,
    "laser_object_id": pa.string(),
}
INTRINSIC = ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")

Row = dict[str, Any]
Change = Callable[[Row], Row | None]
"""What a test does to a row, whose keys are the last parts of column names; None leaves it out."""


def _xyz(prefix: str, kind: pa.DataType = DOUBLE) -> dict[str, pa.DataType]:
    return {f"{prefix}.{axis}": kind for axis in "xyz"}


def _matrix(prefix: str) -> dict[str, pa.DataType]:
    return {f"{prefix}.{name}": kind for name, kind in MATRIX.items()}


COLUMNS: dict[str, tuple[str, tuple[str, ...], dict[str, pa.DataType]]] = {
    "vehicle_pose": (
        "VehiclePoseComponent",
        (FRAME,),
        {"world_from_vehicle.transform": TRANSFORM},
    ),
    "camera_calibration": (
        "CameraCalibrationComponent",
        (CAMERA,),
        {f"intrinsic.{name}": DOUBLE for name in INTRINSIC}
        | {
            "extrinsic.transform": TRANSFORM,
            "width": INT,
            "height": INT,
            "rolling_shutter_direction": BYTE,
        },
    ),
    "camera_image": (
        "CameraImageComponent",
        (FRAME, CAMERA),
        {"image": pa.binary(), "pose.transform": TRANSFORM}
        | _xyz("velocity.linear_velocity", pa.float32())
        | _xyz("velocity.angular_velocity")
        | {
            "pose_timestamp": DOUBLE,
            "rolling_shutter_params.shutter": DOUBLE,
            "rolling_shutter_params.camera_trigger_time": DOUBLE,
            "rolling_shutter_params.camera_readout_done_time": DOUBLE,
        },
    ),
    "lidar_calibration": (
        "LiDARCalibrationComponent",
        (LASER,),
        {
            "extrinsic.transform": TRANSFORM,
            "beam_inclination.min": DOUBLE,
            "beam_inclination.max": DOUBLE,
            "beam_inclination.values": pa.list_(DOUBLE),
        },
    ),
    "lidar": (
        "LiDARComponent",
        (FRAME, LASER),
        _matrix("range_image_return1") | _matrix("range_image_return2"),
    ),
    "lidar_pose": ("LiDARPoseComponent", (FRAME, LASER), _matrix("range_image_return1")),
    "lidar_box": (
        "LiDARBoxComponent",
        (FRAME, "laser_object_id"),
        _xyz("box.center")
        | _xyz("box.size")
        | {"box.heading": DOUBLE, "type": BYTE, "num_lidar_points_in_box": pa.int64()}
        | _xyz("speed"),
    ),
    "stats": (
        "StatsComponent",
        (FRAME,),
        {name: pa.string() for name in ("time_of_day", "location", "weather")},
    ),
}


def write_segment(
    root: Path, change: dict[str, Change] | None = None, rows_per_group: int = 4
) -> Path:
    """Write the segment's components under `root`, their rows in no order; returns `root`."""
    for tag in COLUMNS:
        changed = map((change or {}).get(tag, dict), rows(tag))
        write_component(root, tag, [row for row in changed if row is not None], rows_per_group)
    return root


def write_component(root: Path, tag: str, content: list[Row], rows_per_group: int = 4) -> Path:
    """One parquet file, rows in the order given."""
    component, keys, fields = COLUMNS[tag]
    kinds = {"index": pa.string()}
    kinds |= {f"key.{key}": KEYS[key] for key in ("segment_context_name", *keys)}
    kinds |= {f"[{component}].{field}": kind for field, kind in fields.items()}
    full = [{"segment_context_name": tiny.NAME} | row for row in content]
    shorts = {column: column.split("]." if "]." in column else "key.")[-1] for column in kinds}
    table = pa.table(
        {
            column: pa.array([row.get(shorts[column]) for row in full], kind)
            for column, kind in kinds.items()
        }
    )
    path = root / tag / f"{tiny.NAME}.parquet"
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path, row_group_size=rows_per_group)
    return path


def rows(tag: str) -> list[Row]:
    """The rows of a component, shuffled as in no other."""
    content = list(ROWS[tag]())
    order = np.random.default_rng(len(tag)).permutation(len(content))
    return [content[i] for i in order]


def start(k: int) -> int:
    return tiny.START_US + k * tiny.FRAME_US


def _vehicle_poses() -> Iterable[Row]:
    for k in range(FRAMES):
        pose = tiny.global_from_vehicle(tiny.image_seconds("FRONT", k))
        yield {FRAME: start(k), "world_from_vehicle.transform": pose.ravel()}


def _camera_calibrations() -> Iterable[Row]:
    for number, azimuth in tiny.CAMERAS.values():
        mount = se3.from_rotation_translation(se3.rotation_z(math.radians(azimuth)), [1.5, 0, 2.1])
        yield {
            CAMERA: number,
            **dict(zip((f"intrinsic.{name}" for name in INTRINSIC), tiny.INTRINSIC, strict=True)),
            "extrinsic.transform": mount.ravel(),
            "width": tiny.WIDTH,
            "height": tiny.HEIGHT,
            "rolling_shutter_direction": 2,
        }


def _images() -> Iterable[Row]:
    for k in range(FRAMES):
        for name, (number, _) in tiny.CAMERAS.items():
            seconds = tiny.image_seconds(name, k)
            absolute = tiny.START_US / 1e6 + seconds
            yield {
                FRAME: start(k),
                CAMERA: number,
                "image": tiny.picture(k, name),
                "pose.transform": tiny.global_from_vehicle(seconds).ravel(),
                "pose_timestamp": absolute,
                "rolling_shutter_params.shutter": 0.004,
                "rolling_shutter_params.camera_trigger_time": absolute - 0.026,
                "rolling_shutter_params.camera_readout_done_time": absolute + 0.022,
            }


def _lidar_calibrations() -> Iterable[Row]:
    yield {
        LASER: 1,
        "extrinsic.transform": tiny.TOP.ravel(),
        "beam_inclination.min": -0.3,
        "beam_inclination.max": 0.04,
        "beam_inclination.values": tiny.BEAMS,
    }
    yield {
        LASER: 5,
        "extrinsic.transform": tiny.REAR.ravel(),
        "beam_inclination.min": -1.5,
        "beam_inclination.max": 0.5,
    }


def cells(prefix: str, image: np.ndarray) -> Row:
    return {f"{prefix}.values": image.ravel().astype(np.float32), f"{prefix}.shape": image.shape}


def _range_images() -> Iterable[Row]:
    for k in range(FRAMES):
        for name, number in LASERS.items():
            image, _ = tiny.range_images(k, name)
            yield {
                FRAME: start(k),
                LASER: number,
                **cells("range_image_return1", image),
                **cells("range_image_return2", tiny.second_return(image)),
            }


def _pixel_poses() -> Iterable[Row]:
    for k in range(FRAMES):
        _, poses = tiny.range_images(k, "TOP")
        yield {FRAME: start(k), LASER: 1, **cells("range_image_return1", poses)}


def _boxes() -> Iterable[Row]:
    names = {
        "cx": "center.x",
        "cy": "center.y",
        "cz": "center.z",
        "length": "size.x",
        "width": "size.y",
        "height": "size.z",
        "heading": "heading",
    }
    for k in range(FRAMES):
        for name, kind in tiny.KINDS.items():
            box = tiny.box_values(k, name)
            yield {
                FRAME: start(k),
                "laser_object_id": name,
                "type": kind,
                **{f"box.{column}": box[key] for key, column in names.items()},
            }


def _stats() -> Iterable[Row]:
    for k in range(FRAMES):
        yield {FRAME: start(k), "time_of_day": "Day", "location": "location_sf", "weather": "sunny"}


ROWS: dict[str, Callable[[], Iterable[Row]]] = {
    "vehicle_pose": _vehicle_poses,
    "camera_calibration": _camera_calibrations,
    "camera_image": _images,
    "lidar_calibration": _lidar_calibrations,
    "lidar": _range_images,
    "lidar_pose": _pixel_poses,
    "lidar_box": _boxes,
    "stats": _stats,
}
