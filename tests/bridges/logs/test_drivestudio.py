"""The importer of DriveStudio's processed scenes against a made-up one of known truth."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.geometry import boxes, se3
from recast.logs import DrivingLog, read_log
from support import tiny_processed as tiny
from support.importing import import_drive
from support.street_frame import street_from_world


@pytest.fixture(scope="module")
def tiny_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("drivestudio")
    tiny.write_drivestudio(root)
    return root


@pytest.fixture(scope="module")
def log(tiny_root: Path, tmp_path_factory: pytest.TempPathFactory) -> DrivingLog:
    out = tmp_path_factory.mktemp("out") / "log"
    import_drive("drivestudio", tiny_root, tiny.SCENE, out)
    return read_log(out)


def test_frames_come_ten_a_second_with_their_poses(log: DrivingLog) -> None:
    times = log.world_from_rig.timestamps_us
    np.testing.assert_array_equal(times, 100_000 * np.arange(tiny.FRAMES))
    for time, pose in zip(times, log.world_from_rig.poses, strict=True):
        truth = tiny.street_from_ego(time / 1e6)
        np.testing.assert_allclose(
            street_from_world(log, tiny.GLOBAL_FROM_STREET) @ pose, truth, atol=1e-5
        )


def test_boxes_hold_the_points_of_each_scanner(log: DrivingLog) -> None:
    assert list(log.tracks) == ["0"]  # the other has no boxes
    car = log.tracks["0"]
    assert car.category == "car"
    np.testing.assert_array_equal(car.trajectory.timestamps_us[[0, -1]], [200_000, 1_100_000])
    assert list(log.lidars) == ["lidar_top", "lidar_rear"]
    for lidar, place in zip(log.lidars.values(), tiny.LASERS.values(), strict=True):
        np.testing.assert_allclose(lidar.rig_from_lidar[:3, 3], place, atol=1e-6)
        sweep = lidar.sweeps[5]
        time = sweep.timestamp_us
        np.testing.assert_allclose(sweep.points, tiny.points_in_vehicle(time / 1e6), atol=1e-4)
        truth = np.tanh(np.linspace(0.0, 5.0, tiny.LASER_POINTS))
        np.testing.assert_allclose(sweep.intensity, truth, atol=1e-6)
        pose = se3.inverse(log.world_from_rig.at(time)) @ car.trajectory.at(time)
        assert boxes.contains(sweep.points, tiny.CAR_SIZE, pose).all()


def test_the_lamp_is_painted_where_the_camera_sees_it(log: DrivingLog, tiny_root: Path) -> None:
    lamp = se3.apply(se3.inverse(street_from_world(log, tiny.GLOBAL_FROM_STREET)), tiny.LAMP[None])
    stream = log.cameras["FRONT"]
    for index in (0, 5, 11):
        time = stream.timestamps_us[index]
        camera_from_world = se3.inverse(log.world_from_rig.at(time) @ stream.rig_from_camera)
        pixel, _ = stream.camera.project(se3.apply(camera_from_world, lamp))
        truth = tiny.pixel_of(tiny.LAMP, time / 1e6, 0)
        np.testing.assert_allclose(pixel[0], truth, atol=1e-2)
        row, column = np.nonzero(stream.images[index][..., 1] > 130)
        seen = np.array([column.mean(), row.mean()]) + 0.5
        np.testing.assert_allclose(pixel[0], seen, atol=0.6)
    file = tiny_root / tiny.SCENE / "images/003_0.jpg"
    assert stream.images.encoded(3) == (file.read_bytes(), "jpeg")  # type: ignore[attr-defined]


Damage = Callable[[Path], object]
INFO = "instances/instances_info.json"


def _instance(edit: Callable[[dict], object]) -> Damage:
    def change(scene: Path) -> None:
        instances = json.loads((scene / INFO).read_text())
        edit(instances["0"])
        (scene / INFO).write_text(json.dumps(instances))

    return change


def _boxes(edit: Callable[[dict], object]) -> Damage:
    return _instance(lambda instance: edit(instance["frame_annotations"]))


def _lidar_value(column: int, value: float) -> Damage:
    def change(scene: Path) -> None:
        rows = tiny.lidar_rows(0.0)
        rows[4, column] = value
        rows.astype("<f4").tofile(scene / "lidar/003.bin")

    return change


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda s: (s / INFO).unlink(), f"{INFO}: file: is missing"),
        (lambda s: (s / INFO).write_text("[]"), f"{INFO}: JSON: is not an object"),
        (
            _instance(lambda i: i.update(class_name="Boat")),
            f"{INFO}: 0.class_name: Input should be 'Vehicle'",
        ),
        (
            _boxes(lambda b: b.pop("box_size")),
            f"{INFO}: 0.frame_annotations.box_size: Field required",
        ),
        (
            _boxes(lambda b: b["box_size"].pop()),
            f"{INFO}: 0.frame_annotations: frame_idx, obj_to_world and box_size differ in length",
        ),
        (
            _boxes(lambda b: b["frame_idx"].__setitem__(3, 99)),
            f"{INFO}: 0.frame_annotations.frame_idx: 99 has no file in ego_pose",
        ),
        (
            _boxes(lambda b: b["frame_idx"].__setitem__(3, 4)),
            f"{INFO}: 0.frame_annotations.frame_idx: 4 does not come after 4",
        ),
        (
            _boxes(lambda b: b["box_size"].__setitem__(3, [1, 0, 1])),
            f"{INFO}: 0.frame_annotations.box_size.3: is not a valid box size",
        ),
        (
            _boxes(lambda b: b["obj_to_world"].__setitem__(3, np.eye(4).tolist())),
            f"{INFO}: 0.frame_annotations.obj_to_world.3: the box is 26",
        ),
        (
            _boxes(lambda b: b["obj_to_world"].__setitem__(3, np.ones((4, 4)).tolist())),
            f"{INFO}: 0.frame_annotations.obj_to_world.3: is not a rotation and translation",
        ),
        (
            lambda s: tiny.write_matrix(s / "ego_pose/005.txt", np.eye(4)),
            "ego_pose/005.txt: matrix: is 26218 m from the frame before: mixed",
        ),
        (
            lambda s: shutil.rmtree(s / "ego_pose"),
            "ego_pose: FRAME.txt: there are 0 files, 2 are needed",
        ),
        (lambda s: (s / "ego_pose/005.txt").unlink(), "images/005_0.jpg: frame: 5 has no file"),
        (lambda s: (s / "extrinsics/1.txt").unlink(), "extrinsics/1.txt: file: is missing"),
        (
            lambda s: tiny.write_matrix(s / "extrinsics/000_0.txt", np.eye(4)),
            "extrinsics/000_0.txt: layout: belongs to DriveStudio's layout of a dataset other",
        ),
        (
            lambda s: (s / "lidar/003.bin").write_bytes(b"\0" * 60),
            "lidar/003.bin: points: 60 bytes are not a whole number of 56-byte points",
        ),
        (
            lambda s: (s / "lidar/003.bin").rename(s / "lidar/\u00b2.bin"),
            "lidar/\u00b2.bin: file name: is not a frame",
        ),
        (
            lambda s: tiny.write_matrix(s / "ego_pose/005.txt", np.diag([1.0, 1.0, -1.0, 1.0])),
            "ego_pose/005.txt: matrix: is not a rotation and translation",
        ),
        (
            lambda s: tiny.write_matrix(s / "ego_pose/005.txt", np.full((4, 4), 1e300)),
            "ego_pose/005.txt: matrix: is not a rotation and translation",
        ),
        (
            lambda s: (s / "ego_pose/005.txt").write_bytes(b"\xff" * 9),
            "ego_pose/005.txt: text: is not UTF-8",
        ),
        (
            _boxes(lambda b: b["frame_idx"].__setitem__(3, 10**30)),
            f"{INFO}: 0.frame_annotations.frame_idx: 1000000000000000000000000000000 has no file",
        ),
        (
            _boxes(lambda b: b["box_size"].__setitem__(3, [4, 1e9, 1])),
            f"{INFO}: 0.frame_annotations.box_size.3: is not a valid box size",
        ),
        (_lidar_value(4, 1e9), "lidar/003.bin: point 4: is NaN or infinite, or not within 100000"),
        (_lidar_value(11, np.inf), "lidar/003.bin: point 4: is NaN or infinite"),
        (_lidar_value(13, 5.0), "lidar/003.bin: point 4: laser: is 5, not 0 to 4"),
        (
            lambda s: (s / "lidar/003.bin").rename(s / "lidar/099.bin"),
            "lidar/099.bin: file name: is not a frame",
        ),
    ],
)
def test_a_faulty_scene_is_one_clear_line(
    tiny_root: Path, tmp_path: Path, damage: Damage, message: str
) -> None:
    scene = tmp_path / tiny.SCENE
    shutil.copytree(tiny_root / tiny.SCENE, scene)
    damage(scene)
    with pytest.raises(InputError) as raised:
        import_drive("drivestudio", tmp_path, tiny.SCENE, tmp_path / "out" / "log")
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "out").exists() or list((tmp_path / "out").iterdir()) == []
