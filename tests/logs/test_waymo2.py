"""The Waymo v2 importer: the drive whose truth the tests of v1 check, in the layout of v2."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from recast.logs import DrivingLog, read_log
from recast.logs.importers.waymo import load_waymo2
from recast.logs.importers.waymo2 import RowReader
from support import tiny_waymo as tiny
from support import tiny_waymo2 as tiny2
from support.importing import import_drive


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[DrivingLog, DrivingLog]:
    """The same drive out of both versions."""
    folder = tmp_path_factory.mktemp("waymo2")
    tiny.write_segment(folder / "v1", tiny.Parts(features=[]))
    tiny2.write_segment(folder / "v2" / "training")
    for name, version in (("waymo", "v1"), ("waymo-v2", "v2")):
        import_drive(name, folder / version, tiny.NAME, folder / f"log-{version}")
    return read_log(folder / "log-v1"), read_log(folder / "log-v2")


def test_a_drive_is_the_same_out_of_both_versions(logs: tuple[DrivingLog, DrivingLog]) -> None:
    v1, v2 = logs
    assert v2.name == v1.name == tiny.NAME and v2.map is None
    assert dict(v2.metadata) | {"dataset": "Waymo Open Dataset v1"} == dict(v1.metadata)
    np.testing.assert_array_equal(v2.world_offset, v1.world_offset)
    np.testing.assert_array_equal(v2.world_from_rig.timestamps_us, v1.world_from_rig.timestamps_us)
    np.testing.assert_allclose(v2.world_from_rig.poses, v1.world_from_rig.poses, atol=1e-12)
    assert set(v2.cameras) == set(tiny.CAMERAS) and set(v2.lidars) == {"lidar_top", "lidar_rear"}
    for name, stream in v1.cameras.items():
        other = v2.cameras[name]
        assert other.camera == stream.camera
        np.testing.assert_allclose(other.rig_from_camera, stream.rig_from_camera)
        np.testing.assert_array_equal(other.timestamps_us, stream.timestamps_us)
        for k in range(3):
            assert other.images.encoded(k) == (tiny.picture(k, name), "jpeg")  # type: ignore[attr-defined]
    for name, lidar in v1.lidars.items():
        np.testing.assert_array_equal(v2.lidars[name].timestamps_us, lidar.timestamps_us)
        for k in range(3):
            sweep, other_sweep = lidar.sweeps[k], v2.lidars[name].sweeps[k]
            assert len(sweep.points) > 50
            np.testing.assert_array_equal(other_sweep.points, sweep.points)
            np.testing.assert_array_equal(other_sweep.intensity, sweep.intensity)
            np.testing.assert_array_equal(
                other_sweep.point_timestamps_us, sweep.point_timestamps_us
            )
    assert set(v2.tracks) == {"car", "sign"}
    for name, track in v1.tracks.items():
        other_track = v2.tracks[name]
        assert other_track.category == track.category
        np.testing.assert_allclose(other_track.size, track.size)
        times = track.trajectory.timestamps_us
        np.testing.assert_array_equal(other_track.trajectory.timestamps_us, times)
        np.testing.assert_allclose(other_track.trajectory.poses, track.trajectory.poses, atol=1e-9)


@pytest.mark.parametrize(
    ("missing", "left"),
    [
        ({"camera_image"}, "no images"),
        ({"camera_image", "camera_calibration"}, "no cameras"),
        ({"lidar", "lidar_pose", "lidar_calibration"}, "no LiDAR"),
        ({"lidar_box", "stats"}, "no tracks"),
    ],
)
def test_a_component_that_was_not_downloaded_is_left_out_and_named(
    tmp_path: Path, missing: set[str], left: str
) -> None:
    tiny2.write_segment(tmp_path)
    for tag in missing:
        shutil.rmtree(tmp_path / tag)
    log = load_waymo2(tmp_path, tiny.NAME)
    log.validate()
    assert set(log.metadata["components_left_out"].split(", ")) == missing
    shown = {
        "no images": len(log.cameras) == 5 and all(not len(c.images) for c in log.cameras.values()),
        "no cameras": not log.cameras,
        "no LiDAR": not log.lidars and len(log.cameras) == 5,
        "no tracks": not log.tracks and len(log.lidars) == 2,
    }
    assert shown[left]


def test_names_may_be_text_and_numbers_single_precision(tmp_path: Path) -> None:
    """As in the sample file that the dataset's own tools bring along."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    tiny2.write_segment(tmp_path)
    path = tmp_path / "camera_calibration" / f"{tiny.NAME}.parquet"
    table = pq.read_table(path)
    numbers = {number: name for name, (number, _) in tiny.CAMERAS.items()}
    names = [numbers[number] for number in table["key.camera_name"].to_pylist()]
    column = "[CameraCalibrationComponent].extrinsic.transform"
    single = table[column].cast(pa.list_(pa.float32(), 16))
    table = table.set_column(
        table.column_names.index("key.camera_name"), "key.camera_name", [names]
    )
    table = table.set_column(table.column_names.index(column), column, single)
    pq.write_table(table, path)
    log = load_waymo2(tmp_path, tiny.NAME)
    log.validate()
    assert set(log.cameras) == set(tiny.CAMERAS)


def test_a_second_return_that_is_none_has_no_points(tmp_path: Path) -> None:
    def first_only(row: tiny2.Row) -> tiny2.Row:
        return {key: value for key, value in row.items() if "return2" not in key}

    tiny2.write_segment(tmp_path, {"lidar": first_only})
    sweep = load_waymo2(tmp_path, tiny.NAME).lidars["lidar_rear"].sweeps[1]
    image, _ = tiny.range_images(1, "REAR")
    assert len(sweep.points) == (image[..., 0] > 0).sum()


def test_rows_are_found_forwards_backwards_and_across_row_groups(tmp_path: Path) -> None:
    content = [{"frame_timestamp_micros": k} for k in range(11)]
    path = tiny2.write_component(tmp_path, "stats", content, rows_per_group=4)
    reader = RowReader(path, ["key.frame_timestamp_micros"])
    for row in (0, 1, 3, 3, 2, 10, 4, 7, 8, 0):
        assert reader.cell(row, "key.frame_timestamp_micros").as_py() == row


def test_rows_in_order_cost_one_pass(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny2.write_segment(tmp_path)
    for tag in ("camera_image", "lidar", "lidar_pose"):
        content = sorted(tiny2.ROWS[tag](), key=lambda row: row["frame_timestamp_micros"])
        tiny2.write_component(tmp_path, tag, content, rows_per_group=100)
    log = load_waymo2(tmp_path, tiny.NAME)
    reader = log.lidars["lidar_top"].sweeps.frames[0].lasers["TOP"].returns[0].reader  # type: ignore[attr-defined]
    opened = []
    kind = type(reader._file)
    original = kind.batches

    def counted(file: object, group: int, **options: object) -> object:
        opened.append(group)
        return original(file, group, **options)

    monkeypatch.setattr(kind, "batches", counted)
    for k in range(3):
        assert len(log.lidars["lidar_top"].sweeps[k].points) > 50
    assert opened == [0, 0]  # the range images, and the poses of their pixels
