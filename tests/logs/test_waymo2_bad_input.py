"""Faulty Waymo v2 tables: one line that names file, row and column, and nothing written."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from recast.core.errors import InputError
from support import tiny_waymo as tiny
from support import tiny_waymo2 as tiny2
from support.importing import import_drive

FRAME, CAMERA, LASER = tiny2.FRAME, tiny2.CAMERA, tiny2.LASER
IMAGE, LIDAR = "[CameraImageComponent]", "[LiDARComponent]"
SECOND = tiny2.start(1)


def _file(root: Path, tag: str) -> Path:
    return root / tag / f"{tiny.NAME}.parquet"


def _refused(root: Path, drive: str, message: str) -> None:
    out = root.parent / "out" / "log"
    with pytest.raises(InputError) as raised:
        import_drive("waymo-v2", root, drive, out)
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)
    assert not out.parent.exists() or list(out.parent.iterdir()) == []


def _of(key: dict[str, Any], **changes: Any) -> tiny2.Change:
    """Change the row that has these keys."""
    return lambda row: row | changes if key.items() <= row.items() else row


def _without(**key: Any) -> tiny2.Change:
    return lambda row: None if key.items() <= row.items() else row


def _cell(key: dict[str, Any], column: str, value: Any) -> tiny2.Change:
    return lambda row: row | {column: value} if key.items() <= row.items() else row


FRONT, TOP = {FRAME: SECOND, CAMERA: 1}, {FRAME: SECOND, LASER: 1}
CAR = {FRAME: SECOND, "laser_object_id": "car"}
SHEARED = np.arange(16.0)


@pytest.mark.parametrize(
    ("tag", "change", "message"),
    [
        (
            "vehicle_pose",
            _of({FRAME: SECOND}, segment_context_name="other"),
            "key.segment_context_name: is 'other', but the file is of segment '12345_1000",
        ),
        (
            "lidar_box",
            _of(CAR, segment_context_name="other"),
            "key.segment_context_name: is 'other'",
        ),
        (
            "vehicle_pose",
            _cell({FRAME: SECOND}, "world_from_vehicle.transform", SHEARED),
            "[VehiclePoseComponent].world_from_vehicle.transform: is not a rotation",
        ),
        (
            "vehicle_pose",
            _cell({FRAME: SECOND}, "world_from_vehicle.transform", None),
            "[VehiclePoseComponent].world_from_vehicle.transform: is empty",
        ),
        (
            "vehicle_pose",
            _of({FRAME: SECOND}, **{FRAME: tiny2.start(0)}),
            f"key.frame_timestamp_micros: {tiny2.start(0)} appears twice",
        ),
        (
            "vehicle_pose",
            _without(**{FRAME: SECOND}),
            f"key.frame_timestamp_micros: {SECOND} is not the time of a frame in vehicle_pose",
        ),
        ("vehicle_pose", lambda row: None, "rows: there are none"),
        (
            "vehicle_pose",
            _of({FRAME: tiny2.start(2)}, **{FRAME: tiny2.start(12)}),
            "is not the time of a frame in vehicle_pose",
        ),
        (
            "camera_image",
            _of(FRONT, camera_name=9),
            "key.camera_name: is 9, not a CameraName (1 FRONT, 2 FRONT_LEFT,",
        ),
        ("camera_image", _of(FRONT, camera_name=2), "key.camera_name: FRONT_LEFT appears twice"),
        (
            "camera_image",
            _cell(FRONT, "pose_timestamp", 3.0),
            f"{IMAGE}.pose_timestamp: is -1.55e+09 s after the time of the frame",
        ),
        (
            "camera_image",
            _cell(FRONT, "rolling_shutter_params.shutter", float("nan")),
            f"{IMAGE}.rolling_shutter_params.shutter: is nan",
        ),
        ("camera_image", _cell(FRONT, "image", None), f"{IMAGE}.image: is empty"),
        (
            "camera_image",
            _cell(FRONT, "image", b"no picture"),
            f"{IMAGE}.image: cannot be decoded",
        ),
        (
            "camera_image",
            _cell(FRONT, "image", tiny.picture(1, "FRONT")[:-80]),
            f"{IMAGE}.image: cannot be decoded",
        ),
        (
            "camera_calibration",
            _without(camera_name=1),
            f"{IMAGE}.image: there is no calibration of camera FRONT",
        ),
        ("camera_calibration", _of({CAMERA: 1}, camera_name=2), "FRONT_LEFT appears twice"),
        (
            "camera_calibration",
            _of({CAMERA: 1}, width=0),
            "[CameraCalibrationComponent].intrinsic: PinholeCamera.width, height: 0 x",
        ),
        (
            "camera_calibration",
            _of({CAMERA: 1}, height=33),
            f"{IMAGE}.image: is 48x32, but the camera's calibration says 48x33",
        ),
        (
            "camera_calibration",
            _of({CAMERA: 1}, rolling_shutter_direction=8),
            "[CameraCalibrationComponent].rolling_shutter_direction: is 8, not a RollingShutter",
        ),
        (
            "lidar_calibration",
            _without(laser_name=5),
            f"{LIDAR}.range_image_return1.values: there is no calibration of LiDAR REAR",
        ),
        (
            "lidar_calibration",
            _cell({LASER: 5}, "beam_inclination.max", -2.0),
            "[LiDARCalibrationComponent].beam_inclination.max: -2 is not above the minimum -1.5",
        ),
        (
            "lidar_calibration",
            _cell({LASER: 1}, "beam_inclination.values", [0.1, 0.0]),
            "[LiDARCalibrationComponent].beam_inclination.values: must increase",
        ),
        (
            "lidar_calibration",
            _cell({LASER: 1}, "beam_inclination.values", [0.1, None]),
            "[LiDARCalibrationComponent].beam_inclination.values: is not a list of numbers",
        ),
        (
            "lidar_calibration",
            _cell({LASER: 1}, "beam_inclination.values", [-4.0, 0.1]),
            "[LiDARCalibrationComponent].beam_inclination.values: are not all within pi radians",
        ),
        (
            "lidar",
            _cell(TOP, "range_image_return1.shape", [6, None, 4]),
            f"{LIDAR}.range_image_return1.shape: is not a list of numbers",
        ),
        (
            "lidar",
            _cell(TOP, "range_image_return1.shape", [2**31 - 1] * 3),
            "range_image_return1.values: has dimensions [2147483647, 2147483647, 2147483647] for",
        ),
        (
            "lidar",
            _of(TOP, **tiny2.cells("range_image_return1", np.full((6, 40, 4), 1e9))),
            "range_image_return1.values: holds a range of 1e+09 m",
        ),
        (
            "camera_image",
            _cell(FRONT, "pose.transform", np.diag([1.0, 1.0, -1.0, 1.0]).ravel()),
            f"{IMAGE}.pose.transform: is not a rotation and translation",
        ),
        (
            "camera_image",
            _cell(FRONT, "pose_timestamp", 1e307),
            f"{IMAGE}.pose_timestamp: is 1e+307",
        ),
        (
            "vehicle_pose",
            _cell({FRAME: SECOND}, "frame_timestamp_micros", -1),
            "key.frame_timestamp_micros: -1 is not a time",
        ),
        ("lidar_box", _cell(CAR, "box.size.x", 1e9), "[LiDARBoxComponent].box.size.x: is 1e+09"),
        ("lidar_box", _cell(CAR, "box.center.x", 1e9), "LiDARBoxComponent].box.center.x: is 1e+09"),
        (
            "lidar",
            _of(TOP, **tiny2.cells("range_image_return1", np.zeros((0, 40, 4)))),
            f"{LIDAR}.range_image_return1.values: is empty",
        ),
        (
            "lidar",
            _cell(TOP, "range_image_return1.shape", None),
            f"{LIDAR}.range_image_return1.shape: is empty",
        ),
        (
            "lidar",
            _of(TOP, **tiny2.cells("range_image_return1", np.ones((6, 40, 3)))),
            "range_image_return1.values: has dimensions [6, 40, 3] for 720 values",
        ),
        (
            "lidar",
            _of(TOP, **tiny2.cells("range_image_return1", np.full((6, 40, 4), np.inf))),
            "range_image_return1.values: holds values that are not finite",
        ),
        (
            "lidar",
            _without(**{FRAME: SECOND, LASER: 5}),
            "LiDAR REAR: its range image is missing",
        ),
        (
            "lidar_pose",
            _without(**TOP),
            "the LiDAR TOP has no row in lidar_pose at the frame's time",
        ),
        (
            "lidar_pose",
            _of(TOP, **tiny2.cells("range_image_return1", np.zeros((5, 40, 6)))),
            "[LiDARPoseComponent].range_image_return1.values: is (5, 40), but the range image",
        ),
        ("lidar_box", _of(CAR, type=9), "[LiDARBoxComponent].type: is 9, not a Label.Type (0 unk"),
        (
            "lidar_box",
            _of(CAR, **{"laser_object_id": "sign"}),
            "key.laser_object_id: sign appears twice",
        ),
        (
            "lidar_box",
            _cell(CAR, "box.size.y", 0.0),
            "[LiDARBoxComponent].box.size.y: is 0",
        ),
        ("lidar_box", _cell(CAR, "box.heading", None), "[LiDARBoxComponent].box.heading: is empty"),
    ],
)
def test_a_faulty_row_is_one_clear_line(
    tmp_path: Path, tag: str, change: tiny2.Change, message: str
) -> None:
    root = tiny2.write_segment(tmp_path / "root", {tag: change})
    _refused(root, tiny.NAME, message)


def test_the_message_names_file_and_row(tmp_path: Path) -> None:
    root = tiny2.write_segment(
        tmp_path / "root", {"lidar_box": _cell(CAR, "box.heading", float("nan"))}
    )
    column = "[LiDARBoxComponent].box.heading"
    table = pq.read_table(_file(root, "lidar_box"))
    row = int(np.flatnonzero(np.isnan(table[column].to_numpy()))[0])
    _refused(root, tiny.NAME, f"{_file(root, 'lidar_box')}: row {row}, {column}: is nan, which is")


@pytest.mark.parametrize(
    ("tag", "column"),
    [
        ("vehicle_pose", "key.frame_timestamp_micros"),
        ("camera_image", f"{IMAGE}.image"),
        ("lidar", f"{LIDAR}.range_image_return2.values"),
        ("lidar_box", "[LiDARBoxComponent].type"),
    ],
)
def test_a_column_that_is_missing_or_of_another_kind(tmp_path: Path, tag: str, column: str) -> None:
    root = tiny2.write_segment(tmp_path / "root")
    path = _file(root, tag)
    table = pq.read_table(path)
    pq.write_table(table.drop_columns([column]), path)
    _refused(root, tiny.NAME, f"{path}: column {column}: is missing; download it again")
    index = table.column_names.index(column)
    text = table.set_column(index, column, [["x"] * len(table)])
    pq.write_table(text, path)
    _refused(root, tiny.NAME, column)


def test_text_that_is_not_utf8_is_one_line(tmp_path: Path) -> None:
    root = tiny2.write_segment(tmp_path / "root")
    path = _file(root, "lidar_box")
    data = path.read_bytes()
    path.write_bytes(data.replace(b"car", b"c\xffr"))
    _refused(root, tiny.NAME, f"{path}: row group 0: cannot be read (")


def test_a_component_without_the_segment_is_refused(tmp_path: Path) -> None:
    root = tiny2.write_segment(tmp_path / "root")
    for tag in ("lidar_pose", "lidar_box", "camera_calibration"):
        path = _file(root, tag)
        aside = path.rename(tmp_path / "aside")
        _refused(root, tiny.NAME, f"{path}: file: is missing; download the component {tag}")
        aside.rename(path)
    shutil.rmtree(root / "camera_calibration")
    _refused(root, tiny.NAME, "camera_calibration")


def test_a_damaged_file(tmp_path: Path) -> None:
    root = tiny2.write_segment(tmp_path / "root")
    for tag in ("lidar_box", "lidar"):
        path = _file(root, tag)
        whole = path.read_bytes()
        path.write_bytes(whole[:-30])
        _refused(root, tiny.NAME, f"{path}: parquet file: cannot be read (")
        middle = len(whole) // 4
        path.write_bytes(whole[:middle] + b"\xff" * 200 + whole[middle + 200 :])
        _refused(root, tiny.NAME, f"{path}: ")
        path.write_bytes(whole)


def test_what_is_not_there_is_answered_with_what_is(tmp_path: Path) -> None:
    root = tmp_path / "root"
    _refused(root, "1234", f"{root}: Waymo v2 folder: does not exist")
    tiny2.write_segment(root / "training")
    message = f"{root}: drive 999: has no file in vehicle_pose; choose one of {tiny.NAME}"
    _refused(root, "999", message)
    with pytest.raises(InputError, match="labels: are already in the Waymo segment"):
        import_drive("waymo-v2", root, tiny.NAME, tmp_path / "log", labels=root)
    tiny2.write_segment(root / "validation")
    _refused(root, tiny.NAME, "is ambiguous: training, validation; name the folder of one of these")
