"""A log written and read back is the same log, and broken folders say what is wrong."""

from __future__ import annotations

import json
import multiprocessing
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ncore.data.v4 import SequenceComponentGroupsReader, SequenceLoaderV4

from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import DrivingLog, read_log, write_log
from support.small_log import small_log


@pytest.fixture
def log(rng: np.random.Generator) -> DrivingLog:
    return small_log(rng)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def test_a_log_comes_back_as_it_was(log: DrivingLog, tmp_path: Path) -> None:
    write_log(log, tmp_path / "log")
    back = read_log(tmp_path / "log")
    assert (back.name, back.metadata, back.map) == (log.name, log.metadata, None)
    np.testing.assert_array_equal(back.world_offset, log.world_offset)
    np.testing.assert_array_equal(back.world_from_rig.poses, log.world_from_rig.poses)
    np.testing.assert_array_equal(
        back.world_from_rig.timestamps_us, log.world_from_rig.timestamps_us
    )
    mine, theirs = log.cameras["front"], back.cameras["front"]
    assert theirs.camera == mine.camera
    np.testing.assert_array_equal(theirs.rig_from_camera, mine.rig_from_camera)
    np.testing.assert_array_equal(theirs.timestamps_us, mine.timestamps_us)
    np.testing.assert_array_equal(theirs.mask, mine.mask)
    for i in range(3):
        np.testing.assert_array_equal(theirs.images[i], mine.images[i])
    track, again = log.tracks["car 7"], back.tracks["car 7"]
    assert again.category == "car"
    np.testing.assert_array_equal(again.size, track.size)
    np.testing.assert_array_equal(again.trajectory.timestamps_us, track.trajectory.timestamps_us)
    np.testing.assert_allclose(again.trajectory.poses, track.trajectory.poses, atol=1e-9)


def test_sweeps_come_back_compensated(log: DrivingLog, tmp_path: Path) -> None:
    write_log(log, tmp_path / "log")
    back = read_log(tmp_path / "log").lidars["top"]
    np.testing.assert_array_equal(back.timestamps_us, log.lidars["top"].timestamps_us)
    for i in range(2):
        mine, theirs = log.lidars["top"].sweeps[i], back.sweeps[i]
        assert theirs.timestamp_us == mine.timestamp_us
        np.testing.assert_allclose(theirs.points, mine.points, atol=1e-4)
        np.testing.assert_array_equal(theirs.intensity, mine.intensity)
    assert back.sweeps[0].point_timestamps_us is None
    np.testing.assert_array_equal(
        back.sweeps[1].point_timestamps_us, log.lidars["top"].sweeps[1].point_timestamps_us
    )


def test_ncore_reads_the_same_geometry(log: DrivingLog, tmp_path: Path) -> None:
    """NCore's own loader, its pose graph and its motion compensation agree with ours."""
    write_log(log, tmp_path / "log")
    loader = SequenceLoaderV4(SequenceComponentGroupsReader([tmp_path / "log" / "ncore.json"]))
    assert (loader.camera_ids, loader.lidar_ids) == (["front"], ["top"])
    time = log.cameras["front"].timestamps_us[1]
    pose = loader.pose_graph.evaluate_poses("front", "world", np.array(time))
    expected = log.world_from_rig.at(time) @ log.cameras["front"].rig_from_camera
    np.testing.assert_allclose(pose, expected, atol=1e-6)
    parameters = loader.get_camera_sensor("front").model_parameters
    np.testing.assert_allclose(parameters.radial_coeffs[:3], [0.1, -0.02, 3e-3], rtol=1e-6)
    cloud = loader.get_lidar_sensor("top").get_frame_point_cloud(1, False, False).xyz_m_end
    sweep = log.lidars["top"].sweeps[1]
    for k in (0, 30):  # a raw point, moved by hand through the pose at its own time
        at = log.world_from_rig.at(sweep.point_timestamps_us[k]) @ log.lidars["top"].rig_from_lidar
        world = log.world_from_rig.at(sweep.timestamp_us)
        np.testing.assert_allclose(
            se3.apply(at, cloud[k : k + 1]), se3.apply(world, sweep.points[k : k + 1]), atol=1e-3
        )


def test_two_writings_are_the_same_bytes(tiny_log: DrivingLog, tmp_path: Path) -> None:
    for name in ("one", "two"):
        write_log(tiny_log, tmp_path / name)
    files = sorted(path.name for path in (tmp_path / "one").iterdir())
    for file in files:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


def test_image_files_keep_their_bytes(tiny_drive, tiny_log: DrivingLog) -> None:
    data, kind = tiny_log.cameras["image_02"].images.encoded(3)
    original = tiny_drive.folder / "image_02" / "data" / "0000000003.png"
    assert (data, kind) == (original.read_bytes(), "png")


def _first_pixels(log: DrivingLog) -> int:
    return int(log.cameras["image_02"].images[0].sum())


def test_images_can_be_read_in_a_forked_process(tiny_log: DrivingLog) -> None:
    here = _first_pixels(tiny_log)
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert pool.map(_first_pixels, [tiny_log] * 4) == [here] * 4


def test_an_existing_folder_is_left_alone(log: DrivingLog, tmp_path: Path) -> None:
    (tmp_path / "log").mkdir()
    (tmp_path / "log" / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        write_log(log, tmp_path / "log")
    assert [p.name for p in (tmp_path / "log").iterdir()] == ["mine.txt"]


def test_a_log_that_cannot_be_written_leaves_nothing(log: DrivingLog, tmp_path: Path) -> None:
    sweep = replace(log.lidars["top"].sweeps[0], intensity=np.full(50, 255.0, np.float32))
    lidar = replace(log.lidars["top"], sweeps=[sweep, sweep])
    with pytest.raises(ValueError, match=r"lidars\['top'\].sweeps\[0\].intensity"):
        write_log(replace(log, lidars={"top": lidar}), tmp_path / "log")
    assert list(tmp_path.iterdir()) == []


def _edit(path: Path, **changes: object) -> None:
    data = json.loads(path.read_text())
    path.write_text(json.dumps({**data, **changes}))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda f: shutil.rmtree(f), "log folder: does not exist"),
        (lambda f: (f / "log.json").unlink(), "log.json: is missing"),
        (lambda f: (f / "ncore.json").unlink(), "ncore.json: file: is missing"),
        (lambda f: (f / "log.ncore4-image_02.zarr.itar").unlink(), "itar: file: is missing"),
        (lambda f: (f / "map.json").unlink(), "map.json: file: is missing"),
        (lambda f: (f / "log.json").write_text("{"), "log.json: JSON: cannot be read"),
        (
            lambda f: _edit(f / "log.json", version=2),
            "log.json: version: is 2, this recast reads 1",
        ),
        (lambda f: _edit(f / "log.json", format="other"), "format: is "),
        (lambda f: _edit(f / "log.json", lidars=3), "log.json: lidars: "),
        (lambda f: _edit(f / "log.json", lidars=["roof"]), "'roof'"),
        (lambda f: _cut(f / "log.ncore4.zarr.itar"), "NCore store: cannot be read"),
    ],
)
def test_broken_folders_say_what_is_wrong(
    tiny_log_folder: Path, tmp_path: Path, damage, message: str
) -> None:
    folder = tmp_path / "log"
    shutil.copytree(tiny_log_folder, folder)
    damage(folder)
    with pytest.raises(InputError) as error:
        read_log(folder)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-2000])
