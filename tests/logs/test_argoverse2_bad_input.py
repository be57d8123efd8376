"""Faulty Argoverse 2 logs: one line that names file and field, and nothing written."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pyarrow import feather

from recast.core.errors import InputError
from support import tiny_argoverse2 as tiny
from support.importing import import_drive

POSES = "city_SE3_egovehicle.feather"
MAP = f"map/log_map_archive_{tiny.LOG}____PIT_city_1.json"
SWEEP = f"sensors/lidar/{tiny.START_NS + 4 * tiny.SWEEP_NS}.feather"
IMAGE = f"sensors/cameras/ring_front_center/{tiny.START_NS + 216}.jpg"
INTRINSICS, MOUNTS = "calibration/intrinsics.feather", "calibration/egovehicle_SE3_sensor.feather"

Damage = Callable[[Path], object]


def _column(path: str, name: str, row: int, value: object) -> Damage:
    def change(log: Path) -> None:
        table = feather.read_table(log / path, memory_map=False)
        values = table[name].to_pylist()
        values[row] = value
        dtype = table[name].type.to_pandas_dtype()
        column = values if isinstance(value, str) or value is None else np.array(values, dtype)
        tiny.edit_table(log / path, **{name: column})

    return change


def _without(path: str, name: str) -> Damage:
    return lambda log: tiny.edit_table(log / path, **{name: None})


def _map(edit: Callable[[dict], object]) -> Damage:
    def change(log: Path) -> None:
        data = json.loads((log / MAP).read_text())
        edit(data)
        tiny.write_json(log / MAP, data)

    return change


def _rows(path: str, keep: Callable[[str], bool]) -> Damage:
    def change(log: Path) -> None:
        table = feather.read_table(log / path, memory_map=False)
        kept = table.filter([keep(name) for name in table["sensor_name"].to_pylist()])
        feather.write_feather(kept, str(log / path))

    return change


def _named(path: str, name: str) -> Damage:
    return lambda log: (log / path).rename((log / path).with_name(name))


def _terabyte(log: Path) -> None:
    """A compressed column of the sweep claims 2^40 bytes."""
    count = len(feather.read_table(log / SWEEP, memory_map=False))
    data = (log / SWEEP).read_bytes()
    claim = (4 * count).to_bytes(8, "little")  # offset_ns, the one of four bytes
    assert data.count(claim) >= 1
    (log / SWEEP).write_bytes(data.replace(claim, (1 << 40).to_bytes(8, "little")))


def _raster(header: str) -> Damage:
    def change(log: Path) -> None:
        path = next((log / "map").glob("*.npy"))
        data = path.read_bytes()
        path.write_bytes(data[:10] + header.ljust(117).encode() + b"\n" + data[128:])

    return change


def _only_bicycles(data: dict) -> None:
    for lane in data["lane_segments"].values():
        lane["lane_type"] = "BIKE"


def _elsewhere(data: dict) -> None:
    for lane in data["lane_segments"].values():
        for point in lane["left_lane_boundary"] + lane["right_lane_boundary"]:
            point["x"] -= 1000.0


def _unknown_camera(log: Path) -> None:
    shutil.copytree((log / IMAGE).parent, log / "sensors/cameras/ring_rear_left")


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda f: (f / POSES).unlink(), f"{POSES}: file: is missing"),
        (lambda f: _cut(f / POSES), f"{POSES}: feather table: cannot be read"),
        (_without(POSES, "qz"), f"{POSES}: column qz: is missing"),
        (_column(POSES, "tx_m", 7, np.nan), f"{POSES}: column tx_m, row 7: is nan"),
        (_column(POSES, "qw", 3, 5.0), f"{POSES}: qw, qx, qy, qz in row 3: are not a rotation"),
        (_column(POSES, "timestamp_ns", 9, tiny.START_NS), f"{POSES}: timestamp_ns in row 9"),
        (_without("annotations.feather", "category"), "column category: is missing"),
        (
            _column("annotations.feather", "category", 4, "SPACESHIP"),
            "category in row 4: 'SPACESHIP' is not a category of",
        ),
        (_column("annotations.feather", "tx_m", 1, 1013.0), "tx_m, ty_m, tz_m in row 1: the box"),
        (_column("annotations.feather", "width_m", 2, 0.0), "width_m in row 2: is 0 m"),
        (_column("annotations.feather", "track_uuid", 5, "car"), "appears twice for track car"),
        (_column("annotations.feather", "track_uuid", 5, None), "track_uuid, row 5: is empty"),
        (
            _column("annotations.feather", "timestamp_ns", 4, tiny.START_NS - 10**9),
            "timestamp_ns in row 4: 315966252000000000 lies outside",
        ),
        (lambda f: shutil.rmtree(f / "calibration"), f"{INTRINSICS}: file: is missing"),
        (_column(INTRINSICS, "fx_px", 0, -1.0), f"{INTRINSICS}: sensor ring_front_center"),
        (_unknown_camera, f"{INTRINSICS}: sensor_name ring_rear_left: is missing"),
        (
            _rows(MOUNTS, lambda name: name != "ring_front_center"),
            f"{MOUNTS}: sensor_name ring_front_center: is missing",
        ),
        (
            _rows(MOUNTS, lambda name: name != "down_lidar"),
            f"{MOUNTS}: sensor_name down_lidar: is missing",
        ),
        (_without(SWEEP, "offset_ns"), f"{SWEEP}: column offset_ns: is missing"),
        (_column(SWEEP, "offset_ns", 11, -1), f"{SWEEP}: column offset_ns, row 11: is -1"),
        (_column(SWEEP, "laser_number", 0, 64), f"{SWEEP}: column laser_number, row 0: is 64"),
        (_column(SWEEP, "offset_ns", 0, 10**9), f"{SWEEP}: column offset_ns, row 0: is 1000000000"),
        (lambda f: (f / SWEEP).rename(f / SWEEP.replace("3159", "x")), "is not a time"),
        (
            _named(SWEEP, "\u00b2.feather"),
            "\u00b2.feather: file name: is not a time in nanoseconds",
        ),
        (_named(SWEEP, f"{'9' * 25}.feather"), "99.feather: file name: is not a time in nanosec"),
        (_named(IMAGE, f"{'9' * 19}.jpg"), "99.jpg: file name: is not a time in nanoseconds"),
        (_terabyte, f"{SWEEP}: feather table: cannot be read ("),
        (_column(POSES, "tx_m", 7, 1e300), f"{POSES}: tx_m, ty_m, tz_m in row 7: [1e+300, "),
        (_column(POSES, "qw", 7, 1e300), f"{POSES}: qw, qx, qy, qz in row 7: are not a rotation"),
        (
            _column(POSES, "timestamp_ns", 0, -5),
            f"{POSES}: timestamp_ns in row 0: -5 is not a time",
        ),
        (
            _column(POSES, "timestamp_ns", -1, 2**63 - 1),
            f"{POSES}: timestamp_ns in row 201: 9223372036854775807 is not a time",
        ),
        (_column("annotations.feather", "width_m", 2, 1e9), "width_m in row 2: is 1e+09 m"),
        (lambda f: _cut(f / IMAGE), f"{IMAGE}: image: cannot be decoded"),
        (_column(INTRINSICS, "width_px", 0, 64), "intrinsics.feather says 64x32"),
        (lambda f: (f / MAP).unlink(), "map: log_map_archive_*.json: is missing"),
        (lambda f: _cut(f / MAP), "PIT_city_1.json: JSON: cannot be read"),
        (_map(lambda d: d["lane_segments"].clear()), "lane_segments: contains no lane for cars"),
        (_map(_only_bicycles), "lane_segments: contains no lane for cars"),
        (
            _map(lambda d: d["lane_segments"]["2"].pop("is_intersection")),
            "lane_segments.2.is_intersection: Field required",
        ),
        (
            _map(lambda d: d["lane_segments"]["2"].update(lane_type="TRAM")),
            "lane_segments.2.lane_type: Input should be",
        ),
        (
            _map(lambda d: d["lane_segments"]["3"].update(left_lane_boundary=[])),
            "lane_segments.3.left_lane_boundary: has fewer than two",
        ),
        (
            _map(lambda d: d["lane_segments"]["2"]["left_lane_boundary"][0].update(x=1e300)),
            "lane_segments.2.left_lane_boundary.0.x: Input should be less than",
        ),
        (
            _map(lambda d: d["lane_segments"]["2"]["left_lane_boundary"][0].update(x=9e6)),
            "lane_segments.2.left_lane_boundary: is 899",
        ),
        (_map(_elsewhere), "lane_segments: the ego drives 9"),
        (
            lambda f: next((f / "map").glob("*Sim2*")).unlink(),
            "map: *___img_Sim2_city.json: is missing",
        ),
        (
            lambda f: _cut(next((f / "map").glob("*.npy"))),
            "PIT.npy: array: cannot be read (",
        ),
        (_raster("{'descr': '<f2', 'shape': (9"), "PIT.npy: array: cannot be read ("),
        (
            _raster("{'descr': '<f2', 'fortran_order': False, 'shape': (99999999, 99999)}"),
            "PIT.npy: array: cannot be read (",
        ),
    ],
)
def test_a_faulty_log_is_one_clear_line(tmp_path: Path, damage: Damage, message: str) -> None:
    folder = tiny.write_tiny_log(tmp_path / "root")
    damage(folder)
    with pytest.raises(InputError) as raised:
        import_drive("argoverse2", tmp_path / "root", tiny.LOG, tmp_path / "out" / "log")
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "out").exists() or list((tmp_path / "out").iterdir()) == []


def test_a_log_that_is_not_there_is_answered_with_those_that_are(tmp_path: Path) -> None:
    tiny.write_tiny_log(tmp_path)
    with pytest.raises(InputError, match=f"drive 7fab: does not exist; choose one of {tiny.LOG}"):
        import_drive("argoverse2", tmp_path, "7fab", tmp_path / "log")
    with pytest.raises(InputError, match="Argoverse 2 folder: does not exist"):
        import_drive("argoverse2", tmp_path / "nowhere", tiny.LOG, tmp_path / "log")
