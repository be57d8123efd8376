"""The nuScenes importer against a made-up dataset whose truth is known."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.geometry import boxes, se3
from recast.logs import DrivingLog, read_log, track_points
from recast.logs.derive_map import map_of
from recast.logs.importers.nuscenes import load_nuscenes
from recast.logs.importers.nuscenes_tables import stream_rows
from support import tiny_nuscenes as tiny
from support.importing import import_drive
from support.street_frame import street_from_world


@pytest.fixture(scope="module")
def tiny_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("nuscenes")
    tiny.write_tiny_nuscenes(root)
    return root


@pytest.fixture(scope="module")
def log(tiny_root: Path, tmp_path_factory: pytest.TempPathFactory) -> DrivingLog:
    out = tmp_path_factory.mktemp("out") / "log"
    import_drive("nuscenes", tiny_root, tiny.SCENE, out)
    return read_log(out)


def _seconds(time_us: int) -> float:
    return (int(time_us) - tiny.START_US) / 1e6


def test_the_ego_has_the_pose_of_every_frame(log: DrivingLog) -> None:
    times = log.world_from_rig.timestamps_us
    assert set(log.cameras["CAM_FRONT"].timestamps_us) <= set(times)
    assert set(log.lidars["LIDAR_TOP"].timestamps_us) <= set(times)
    for time, pose in zip(times, log.world_from_rig.poses, strict=True):
        truth = tiny.street_from_ego(_seconds(time))
        np.testing.assert_allclose(
            street_from_world(log, tiny.GLOBAL_FROM_STREET) @ pose, truth, atol=1e-5
        )
    np.testing.assert_allclose(log.world_from_rig.poses[0, :3, 3], 0.0, atol=1e-9)


def test_boxes_are_those_of_key_frames_and_ten_a_second_between_them(log: DrivingLog) -> None:
    kinds = {key: track.category for key, track in log.tracks.items()}
    assert kinds == {"car": "car", "walk": "pedestrian"}  # not the ego's own box
    car = log.tracks["car"]
    np.testing.assert_allclose(car.size, tiny.CAR_SIZE)
    np.testing.assert_array_equal(np.diff(car.trajectory.timestamps_us), tiny.KEY_US // 5)
    # Every sweep is near a label.
    assert len(track_points(log, car).points) == 41 * tiny.CAR_POINTS
    for time in tiny.START_US + np.arange(0, 2_000_000, 130_000):
        pose = street_from_world(log, tiny.GLOBAL_FROM_STREET) @ car.trajectory.at(time)
        np.testing.assert_allclose(pose, tiny.street_from_car(_seconds(time)), atol=1e-5)


def test_nothing_is_filled_in_over_a_key_frame_without_a_box(
    tiny_root: Path, tmp_path: Path
) -> None:
    shutil.copytree(tiny_root, tmp_path / "gap")
    tables = tmp_path / "gap" / tiny.VERSION
    rows = tiny.read_table(tables, "sample_annotation")
    tiny.write_table(tables, "sample_annotation", [row for row in rows if row["token"] != "car2"])
    times = load_nuscenes(tmp_path / "gap", tiny.SCENE).tracks["car"].trajectory.timestamps_us
    seconds = (times - tiny.START_US) / 1e6
    np.testing.assert_allclose(seconds[:6], 0.1 * np.arange(6))
    np.testing.assert_allclose(seconds[6:], 1.5 + 0.1 * np.arange(6))


def test_sweeps_lie_on_the_car_and_the_road(log: DrivingLog) -> None:
    lidar = log.lidars["LIDAR_TOP"]
    assert len(lidar.sweeps) == 41
    np.testing.assert_allclose(lidar.rig_from_lidar, tiny.EGO_FROM_LIDAR, atol=1e-6)
    for index in (0, 13):
        sweep = lidar.sweeps[index]
        time = sweep.timestamp_us
        written = tiny.sweep_rows(_seconds(time))
        assert len(sweep.points) == len(written) - 9  # not the ego's own roof
        truth = se3.apply(tiny.EGO_FROM_LIDAR, written[:-9, :3])
        np.testing.assert_allclose(sweep.points, truth, atol=1e-4)
        np.testing.assert_allclose(sweep.intensity, written[:-9, 3] / 255, atol=1e-6)
        pose = se3.inverse(log.world_from_rig.at(time)) @ log.tracks["car"].trajectory.at(time)
        assert boxes.contains(sweep.points, tiny.CAR_SIZE, pose).sum() == tiny.CAR_POINTS


def test_images_keep_their_bytes_and_show_the_lamp_where_it_is(
    log: DrivingLog, tiny_root: Path
) -> None:
    stream = log.cameras["CAM_FRONT"]
    files = sorted(tiny_root.glob("s*/CAM_FRONT/*.jpg"), key=lambda path: path.name)
    assert len(stream.images) == len(files) == 25
    assert stream.images.encoded(7) == (files[7].read_bytes(), "jpeg")  # type: ignore[attr-defined]
    lamp = se3.apply(se3.inverse(street_from_world(log, tiny.GLOBAL_FROM_STREET)), tiny.LAMP[None])
    for index in (0, 7, 24):
        world_from_camera = (
            log.world_from_rig.at(stream.timestamps_us[index]) @ stream.rig_from_camera
        )
        pixel, depth = stream.camera.project(se3.apply(se3.inverse(world_from_camera), lamp))
        row, column = np.nonzero(stream.images[index][..., 1] > 130)
        seen = np.array([column.mean(), row.mean()]) + 0.5
        assert depth[0] > 10
        np.testing.assert_allclose(pixel[0], seen, atol=0.6)


@settings(max_examples=40, deadline=None)
@given(st.floats(12.0, 60.0), st.floats(-8.0, 8.0), st.floats(0.0, 6.0), st.integers(0, 24))
def test_any_point_ahead_hits_the_pixel_the_tables_say(
    log: DrivingLog, x: float, y: float, z: float, index: int
) -> None:
    stream = log.cameras["CAM_FRONT"]
    time = stream.timestamps_us[index]
    world = se3.apply(
        se3.inverse(street_from_world(log, tiny.GLOBAL_FROM_STREET)), np.array([[x, y, z]])
    )
    camera_from_world = se3.inverse(log.world_from_rig.at(time) @ stream.rig_from_camera)
    pixel, _ = stream.camera.project(se3.apply(camera_from_world, world))
    truth = tiny.pixel_of(np.array([x, y, z]), _seconds(time))
    np.testing.assert_allclose(pixel[0], truth + 0.5, atol=1e-3)  # pixel centres at +0.5


def test_the_log_tells_where_it_is_from_and_gets_a_derived_map(log: DrivingLog) -> None:
    assert log.metadata["dataset"] == "nuScenes v1.0-mini"
    assert log.metadata["location"] == "singapore-onenorth"
    assert log.map is None
    assert map_of(log).derived


def test_without_the_sweeps_folder_key_frames_are_read(tiny_root: Path, tmp_path: Path) -> None:
    shutil.copytree(tiny_root, tmp_path / "keys", ignore=shutil.ignore_patterns("sweeps"))
    log = load_nuscenes(tmp_path / "keys", tiny.SCENE)
    assert len(log.cameras["CAM_FRONT"].images) == len(log.lidars["LIDAR_TOP"].sweeps) == 5


def test_tables_stream_whatever_their_layout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "table.json"
    path.write_text('[\n{"token": "a}],", "n": [1, {"m": 2}]},\n{"token": "é"}\n]\n')
    whole = list(stream_rows(path))
    assert whole == [{"token": "a}],", "n": [1, {"m": 2}]}, {"token": "é"}]
    for chunk in (1, 2, 3, 7):
        monkeypatch.setattr("recast.logs.importers.nuscenes_tables._CHUNK", chunk)
        assert list(stream_rows(path)) == whole
    path.write_text("[]")
    assert list(stream_rows(path)) == []


def test_a_sensor_without_sweeps_goes_on_with_key_frames(tiny_root: Path, tmp_path: Path) -> None:
    shutil.copytree(tiny_root, tmp_path / "data")
    shutil.rmtree(tmp_path / "data/sweeps/CAM_FRONT")
    log = load_nuscenes(tmp_path / "data", tiny.SCENE)
    assert len(log.cameras["CAM_FRONT"].images) == 5 and len(log.lidars["LIDAR_TOP"].sweeps) == 41


def test_tables_that_nothing_is_read_from_may_be_missing(tiny_root: Path, tmp_path: Path) -> None:
    shutil.copytree(tiny_root, tmp_path / "data")
    tables = tmp_path / "data/v1.0-mini"
    tiny.write_table(tables, "sample_annotation", [])
    for name in ("attribute", "category", "instance", "log", "map", "visibility"):
        (tables / f"{name}.json").unlink()
    log = load_nuscenes(tmp_path / "data", tiny.SCENE)
    assert not log.tracks and "location" not in log.metadata and log.cameras["CAM_FRONT"].images
