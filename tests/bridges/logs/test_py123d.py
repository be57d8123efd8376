"""The py123d importer against a stand-in of the package: no real py123d has been met."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.logs import DrivingLog, read_log
from recast_bridges.logs.py123d import category, load_py123d
from support import tiny_py123d as tiny
from support.importing import import_drive


def _imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scene: Any) -> DrivingLog:
    root = tiny.install(monkeypatch, tmp_path / "data", scene)
    import_drive("py123d", root, tiny.NAME, tmp_path / "log")
    return read_log(tmp_path / "log")


@pytest.mark.parametrize("merged", [True, False])
def test_a_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, merged: bool) -> None:
    log = _imported(tmp_path, monkeypatch, tiny.Scene(merged=merged))
    assert log.name == tiny.NAME and log.metadata["cameras_left_out"] == "left_fisheye"
    # The rig stands on the ground below the rear axle, and the world begins at its first pose.
    np.testing.assert_allclose(log.world_offset, tiny.FAR, atol=1e-9)
    for k in range(tiny.FRAMES):
        pose = log.world_from_rig.at(tiny.stamp(k).time_us)
        np.testing.assert_allclose(pose[:3, 3], [k, 0.0, 0.0], atol=1e-6)
    rig_from_imu = np.array([-0.1, 0.3, tiny.AXLE_HEIGHT])
    front = log.cameras["front"]
    assert set(log.cameras) == {"front"}
    assert front.camera.distortion == (0.1, -0.2, 0.01, 0.02, 0.3)
    np.testing.assert_allclose(front.rig_from_camera[:3, 3], [1.5, 0.5, 1.1 + tiny.AXLE_HEIGHT])
    assert len(front.timestamps_us) == tiny.FRAMES + 1  # those beyond the ego's motion are left
    np.testing.assert_array_equal(front.images[3], tiny.picture(3))
    for key, (name, _) in tiny.LIDARS.items():
        sweep = log.lidars[name].sweeps[2]
        np.testing.assert_allclose(sweep.points, tiny.POINTS[key] + rig_from_imu, atol=1e-4)
        np.testing.assert_allclose(sweep.intensity, key * 25 / 255, atol=1e-6)
    assert {key: track.category for key, track in log.tracks.items()} == {
        "car": "car",
        "bus": "bus",
        "rider": "cyclist",
    }
    car = log.tracks["car"].trajectory
    np.testing.assert_allclose(car.poses[4][:3, 3], [30.0 - 3.2, 4.0, 0.8], atol=1e-6)


def test_the_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = _imported(tmp_path, monkeypatch, tiny.Scene())
    assert log.map is not None and not log.map.derived
    log.map.validate()
    assert set(log.map.lanes) == {"1", "2"}  # no bicycle lane
    lane = log.map.lanes["1"]
    np.testing.assert_allclose(lane.centreline[[0, -1]], [[-20, 0, 0], [90, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(lane.left_boundary[:, 1], 1.7, atol=1e-6)
    assert (lane.successors, lane.left_neighbour, lane.speed_limit) == (("2",), "2", 13.9)
    assert log.map.lanes["2"].is_intersection and not lane.is_intersection
    assert len(log.map.drivable_area) == 4  # three lanes and a group
    assert _imported(tmp_path / "b", monkeypatch, tiny.Scene(map=None)).map is None


def test_a_map_without_heights_lies_where_the_ego_drives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = tiny.Scene(map=tiny.Map(tiny.flat(tiny.lanes()), map_has_z=False))
    log = _imported(tmp_path, monkeypatch, scene)
    assert log.map is not None
    np.testing.assert_allclose(log.map.lanes["1"].left_boundary[:, 2], 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("own", "common", "ours"),
    [
        ("REGULAR_VEHICLE", "VEHICLE", "car"),
        ("BOX_TRUCK", "VEHICLE", "truck"),
        ("ARTICULATED_BUS", "VEHICLE", "bus"),
        ("CAR", "VEHICLE", "car"),
        ("RAILED_VEHICLE", "TRAIN", "tram"),
        ("VEHICULAR_TRAILER", "VEHICLE", "trailer"),
        ("MOTORCYCLIST", "PERSON", "motorcyclist"),
        ("MOTORCYCLE", "TWO_WHEELER", "motorcyclist"),
        ("PEDESTRIAN", "PERSON", "pedestrian"),
        ("BICYCLE", "TWO_WHEELER", "cyclist"),
        ("CONSTRUCTION_CONE", "TRAFFIC_CONE", "misc"),
        ("HOVERCRAFT", "HOVERCRAFT", None),
    ],
)
def test_categories(own: str, common: str, ours: str | None) -> None:
    assert category(own, common) == ours


def _boxes(*more: Any) -> Any:
    return lambda k: [*tiny.boxes(k), *more]


FRONT = tiny.camera_metadata
CASES = {
    "two states": (tiny.Scene(states=1), "ego states: there are fewer than two"),
    "intrinsics": (
        tiny.Scene(cameras={"f": FRONT("front", "PINHOLE", intrinsics=None)}),
        "camera front: has no intrinsics; convert",
    ),
    "size": (
        tiny.Scene(cameras={"f": FRONT("front", "PINHOLE", width=25)}),
        "camera front at 1600000000000000 us: has an image of (16, 24, 3), but its calibration",
    ),
    "image": (tiny.Scene(pictures=lambda k: None), "camera front at 1600000000000000 us: has no"),
    "ids": (tiny.Scene(ids=False), "LiDAR lidar_top at 1600000000000000 us: is merged with"),
    "twice": (
        tiny.Scene(detections=_boxes(tiny.box("car", "CAR", "VEHICLE", tiny.FAR))),
        "box car at 1600000000000000 us: appears twice",
    ),
    "label": (
        tiny.Scene(detections=_boxes(tiny.box("x", "UFO", "UFO", tiny.FAR))),
        "track x: has the label UFO, which recast does not know; use one of VEHICLE, TRAIN,",
    ),
    "box": (
        tiny.Scene(detections=_boxes(tiny.box("x", "CAR", "VEHICLE", tiny.FAR, (0, 1, 1)))),
        "track x: has a box without a valid position or size",
    ),
    "map": (
        tiny.Scene(map=tiny.Map([tiny.lane(1, 140.0, "SURFACE_STREET")])),
        "map: the ego drives",
    ),
    "asserts": (
        tiny.Scene(detections=lambda k: [][k]),
        "log: py123d cannot read it (IndexError: list index out of range); convert it again",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_a_faulty_log_is_one_clear_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    scene, message = CASES[case]
    if case == "map":
        monkeypatch.setattr("recast_bridges.logs.py123d.NEAR", 100.0)
    with pytest.raises(InputError) as raised:
        _imported(tmp_path, monkeypatch, scene)
    assert message in str(raised.value) and tiny.NAME in str(raised.value)
    assert "\n" not in str(raised.value) and not (tmp_path / "log").exists()


def test_what_is_not_there_is_answered_with_what_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match="py123d data: has no folder logs"):
        load_py123d(tmp_path, "x")
    tiny.install(monkeypatch, tmp_path, tiny.Scene())
    with pytest.raises(InputError, match=f"drive x: does not exist; choose one of {tiny.NAME}"):
        load_py123d(tmp_path, "x")
    monkeypatch.setitem(sys.modules, "py123d.api.scene.arrow.arrow_scene_api", None)
    with pytest.raises(InputError, match=r"py123d: package: cannot be imported .*; pip install"):
        load_py123d(tmp_path, tiny.NAME)


def test_files_that_py123d_would_map_as_they_are_are_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tiny.install(monkeypatch, tmp_path, tiny.Scene())
    path = root / "logs" / "av2-sensor_val" / tiny.NAME / "sync.arrow"
    whole = path.read_bytes()
    path.write_bytes(whole[:-10])
    with pytest.raises(InputError, match=r"sync\.arrow: Arrow file: cannot be read"):
        load_py123d(root, tiny.NAME)
    path.write_bytes(b"")
    with pytest.raises(InputError, match=r"sync\.arrow: Arrow file: cannot be read"):
        load_py123d(root, tiny.NAME)


@pytest.mark.parametrize("error", [RuntimeError, OverflowError, NotImplementedError, MemoryError])
def test_whatever_py123d_raises_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: type[Exception]
) -> None:
    def failing(*_: object) -> None:
        raise error("of its own")

    monkeypatch.setattr(tiny.Scene, "get_lidar_at_timestamp", failing)
    with pytest.raises(InputError, match=f"py123d cannot read it .{error.__name__}: of its own"):
        _imported(tmp_path, monkeypatch, tiny.Scene())
    assert not (tmp_path / "log").exists()


def _ego(change: Callable[[np.ndarray], None]) -> Callable[[tiny.Scene, int], Any]:
    """The ego poses with the last one changed."""

    def state(self: tiny.Scene, timestamp: int) -> Any:
        pose = tiny.placed(tiny.there(1e-5 * (timestamp - tiny.START_US), 0, 1))
        if timestamp == tiny.START_US + (tiny.FRAMES - 1) * tiny.STEP_US:
            change(pose.transformation_matrix)
        return SimpleNamespace(imu_se3=pose)

    return state


def _points(value: float) -> Callable[..., Any]:
    def cloud(self: tiny.Scene, timestamp: int, lidar_id: int) -> Any:
        points = np.full((3, 3), value, np.float32)
        return SimpleNamespace(
            point_cloud_3d=points, is_merged=False, ids=None, intensity=None, timestamps=None
        )

    return cloud


def _box(place: Any = (30.0, 4.0, 0.8), size: Any = (4.5, 1.9, 1.6)) -> Callable[..., Any]:
    found = tiny.box("car", "REGULAR_VEHICLE", "VEHICLE", tiny.there(*place), size)
    return lambda self, timestamp: [found]


@pytest.mark.parametrize(
    ("method", "replacement", "message"),
    [
        ("get_ego_state_se3_at_timestamp", _ego(lambda m: m.fill(np.nan)), "nan is not"),
        (
            "get_ego_state_se3_at_timestamp",
            _ego(lambda m: m.__setitem__((2, 2), -1.0)),
            "is a mirror image of a rotation",
        ),
        (
            "get_ego_state_se3_at_timestamp",
            _ego(lambda m: m.__setitem__((0, 3), 1e300)),
            "1e+300 is",
        ),
        ("get_lidar_at_timestamp", _points(1e30), "is not within 100000 m"),
        (
            "get_box_detections_se3_at_timestamp",
            _box(size=(4.5, np.nan, 1.6)),
            "track car: has a box without",
        ),
        (
            "get_box_detections_se3_at_timestamp",
            _box(size=(4.5, 1e9, 1.6)),
            "track car: has a box without",
        ),
        (
            "get_box_detections_se3_at_timestamp",
            _box((np.nan, 0.0, 0.0)),
            "track car: has a box without",
        ),
        ("get_box_detections_se3_at_timestamp", _box((1e12, 0.0, 0.0)), "1e+12 is not within"),
        ("get_all_ego_state_se3_timestamps", lambda s: [tiny.stamp(10**12)] * 2, "is not a time"),
        ("get_all_ego_state_se3_timestamps", lambda s: [tiny.stamp(0)] * 2, "increase"),
    ],
)
def test_values_out_of_range_are_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    method: str,
    replacement: Any,
    message: str,
) -> None:
    monkeypatch.setattr(tiny.Scene, method, replacement)
    with pytest.raises(InputError) as raised:
        _imported(tmp_path, monkeypatch, tiny.Scene(map=None))
    assert message in str(raised.value) and "\n" not in str(raised.value)
    assert not (tmp_path / "log").exists()
