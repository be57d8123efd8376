"""What holds for a whole Waymo v2 segment: calibrations, and when and where it was."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from recast.logs.importers.waymo2_files import Components
from recast.logs.importers.waymo2_tables import Row
from recast.logs.importers.waymo_schema import CAMERA_NAME, LASER_NAME, ROLLING_SHUTTER
from recast.logs.importers.waymo_segment import CameraCalibration, LaserCalibration
from recast.logs.importers.waymo_values import camera_calibration, laser_calibration
from recast.logs.importers.waymo_wire import Choice, FieldError

CAMERA, LASER = "key.camera_name", "key.laser_name"
_INTRINSIC = [f"intrinsic.{n}" for n in ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")]
_BEAMS = "beam_inclination"
_STATS = ["time_of_day", "location", "weather"]


def read_cameras(components: Components) -> dict[str, CameraCalibration]:
    """Cameras by name; none where neither calibrations nor images were downloaded.

    Raises:
        InputError: the file is missing or damaged, or a calibration is wrong or there twice.
    """
    found: dict[str, CameraCalibration] = {}
    if not components.has("camera_calibration") and not components.has("camera_image"):
        return found
    fields = ["width", "height", *_INTRINSIC, "extrinsic.transform", "rolling_shutter_direction"]
    for row in components.table("camera_calibration").rows([CAMERA, *fields]):
        with row.place.errors():
            name = _new_name(row, CAMERA, CAMERA_NAME, found)
            found[name] = camera_calibration(
                row.column("intrinsic"),
                (row.integer("width"), row.integer("height")),
                [row.number(field) for field in _INTRINSIC],
                row.pose("extrinsic"),
                row.choice("rolling_shutter_direction", ROLLING_SHUTTER),
            )
    return found


def read_lasers(components: Components) -> dict[str, LaserCalibration]:
    """LiDARs by name; none where no range images were downloaded.

    Raises:
        InputError: the file is missing or damaged, or a calibration is wrong or there twice.
    """
    found: dict[str, LaserCalibration] = {}
    if not components.has("lidar"):
        return found
    beams, ends = f"{_BEAMS}.values", (f"{_BEAMS}.min", f"{_BEAMS}.max")
    fields = [beams, *ends, "extrinsic.transform"]
    for row in components.table("lidar_calibration").rows([LASER, *fields]):
        with row.place.errors():
            values = row.numbers(beams)
            found[_new_name(row, LASER, LASER_NAME, found)] = laser_calibration(
                (row.column(beams), values),
                {} if len(values) else {row.column(end): row.number(end) for end in ends},
                row.pose("extrinsic"),
            )
    return found


def _new_name(row: Row, column: str, choice: Choice, known: Mapping[str, Any]) -> str:
    name = row.choice(column, choice)
    if name in known:
        raise FieldError(column, f"{name} is there twice")
    return name


def read_notes(components: Components) -> dict[str, str]:
    """Statistics of the first frame, and which components are not there."""
    notes: dict[str, str] = {}
    if components.has("stats"):
        for row in components.table("stats").rows(_STATS):
            with row.place.errors():
                notes = {field: row.text(field) for field in _STATS}
            break
    left_out = ", ".join(components.left_out())
    return notes | ({"components_left_out": left_out} if left_out else {})
