"""The importer of Street Gaussians' processed scenes against a made-up one of known truth."""

from __future__ import annotations

import json
import re
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.core.errors import InputError
from recast.geometry import boxes, se3
from recast.logs import DrivingLog, read_log
from recast_bridges.logs.street_gaussians import load_street_gaussians
from support import tiny_processed as tiny
from support.doc_blocks import REPOSITORY
from support.importing import import_drive
from support.street_frame import street_from_world

START_US = round(tiny.START * 1e6)


@pytest.fixture(scope="module")
def tiny_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("street_gaussians")
    tiny.write_street_gaussians(root)
    return root


@pytest.fixture(scope="module")
def log(tiny_root: Path, tmp_path_factory: pytest.TempPathFactory) -> DrivingLog:
    out = tmp_path_factory.mktemp("out") / "log"
    import_drive("street-gaussians", tiny_root, tiny.SCENE, out)
    return read_log(out)


def test_images_have_the_ego_pose_of_their_own_time(log: DrivingLog) -> None:
    assert list(log.cameras) == ["FRONT", "FRONT_LEFT"]
    for number, stream in enumerate(log.cameras.values()):
        seconds = (stream.timestamps_us - START_US) / 1e6
        expected = 0.1 * np.arange(tiny.FRAMES) + tiny.CAMERA_DELAY[number]
        np.testing.assert_allclose(seconds, expected, atol=2e-6)
        for time, second in zip(stream.timestamps_us, seconds, strict=True):
            pose = street_from_world(log, tiny.GLOBAL_FROM_STREET) @ log.world_from_rig.at(time)
            np.testing.assert_allclose(pose, tiny.street_from_ego(second), atol=1e-4)


def test_boxes_and_points_hold_when_the_frame_s_pose_does(log: DrivingLog) -> None:
    assert list(log.tracks) == ["7"]  # signs are left out
    car, lidar = log.tracks["7"], log.lidars["lidar"]
    np.testing.assert_allclose(car.size, tiny.CAR_SIZE)
    seconds = (car.trajectory.timestamps_us - START_US) / 1e6
    # Measured from the poses: timestamps.json has the beginning of the scan.
    np.testing.assert_allclose(seconds, 0.1 * np.arange(tiny.FRAMES) + 0.047, atol=1.5e-3)
    for k, time in enumerate(car.trajectory.timestamps_us):
        truth = tiny.street_from_car(0.1 * k + tiny.FRAME_DELAY)
        np.testing.assert_allclose(
            street_from_world(log, tiny.GLOBAL_FROM_STREET) @ car.trajectory.poses[k],
            truth,
            atol=1e-4,
        )
        sweep = lidar.sweeps[k]
        assert sweep.timestamp_us == time
        pose = se3.inverse(log.world_from_rig.at(time)) @ car.trajectory.poses[k]
        assert boxes.contains(sweep.points, tiny.CAR_SIZE, pose).all()
        assert len(sweep.points) == tiny.LASER_POINTS


def test_the_lamp_is_painted_where_the_camera_sees_it(log: DrivingLog, tiny_root: Path) -> None:
    lamp = se3.apply(se3.inverse(street_from_world(log, tiny.GLOBAL_FROM_STREET)), tiny.LAMP[None])
    stream = log.cameras["FRONT"]
    assert stream.camera.distortion == tiny.INTRINSIC[4:]
    for index in (0, 5, 11):
        time = stream.timestamps_us[index]
        camera_from_world = se3.inverse(log.world_from_rig.at(time) @ stream.rig_from_camera)
        pixel, _ = stream.camera.project(se3.apply(camera_from_world, lamp))
        row, column = np.nonzero(stream.images[index][..., 1] > 130)
        seen = np.array([column.mean(), row.mean()]) + 0.5
        np.testing.assert_allclose(pixel[0], seen, atol=0.51)
    file = tiny_root / tiny.SCENE / "images/000003_0.png"
    assert stream.images.encoded(3) == (file.read_bytes(), "png")  # type: ignore[attr-defined]


@settings(max_examples=40, deadline=None)
@given(st.floats(20.0, 60.0), st.floats(-6.0, 6.0), st.floats(0.0, 6.0), st.integers(0, 11))
def test_any_point_ahead_hits_the_pixel_of_waymo_s_model(
    log: DrivingLog, x: float, y: float, z: float, index: int
) -> None:
    stream = log.cameras["FRONT"]
    time = stream.timestamps_us[index]
    world = se3.apply(
        se3.inverse(street_from_world(log, tiny.GLOBAL_FROM_STREET)), np.array([[x, y, z]])
    )
    camera_from_world = se3.inverse(log.world_from_rig.at(time) @ stream.rig_from_camera)
    pixel, _ = stream.camera.project(se3.apply(camera_from_world, world))
    truth = tiny.pixel_of(np.array([x, y, z]), (time - START_US) / 1e6, 0)
    np.testing.assert_allclose(pixel[0], truth, atol=2e-2)


def test_labels_of_a_tracker_and_a_scene_without_points(tiny_root: Path, tmp_path: Path) -> None:
    shutil.copytree(tiny_root / tiny.SCENE, tmp_path / tiny.SCENE)
    (tmp_path / tiny.SCENE / "pointcloud.npz").unlink()
    other = tmp_path / "castrack.txt"
    other.write_text("header\n2 1 Pedestrian 0 1.8 0.5 0.6 5 1 0.9 0.1\n")  # without speed
    log = load_street_gaussians(tmp_path / tiny.SCENE, tiny.SCENE, other)
    assert log.lidars == {}
    assert [track.category for track in log.tracks.values()] == ["pedestrian"]
    log.validate()


def test_points_converted_as_the_documentation_says_are_read(
    tiny_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = tmp_path / tiny.SCENE
    shutil.copytree(tiny_root / tiny.SCENE, scene)
    _pickled_points(scene)
    documentation = REPOSITORY / "docs" / "data.md"
    lines = re.search(r"```python\n([^`]*allow_pickle[^`]*)```", documentation.read_text())
    assert lines is not None
    monkeypatch.chdir(scene)
    exec(lines[1], {})
    sweeps = load_street_gaussians(tmp_path, tiny.SCENE).lidars["lidar"].sweeps
    assert [len(sweeps[k].points) for k in range(len(sweeps))] == [3, 3]


Damage = Callable[[Path], object]


def _edit(name: str, old: str, new: str) -> Damage:
    def change(scene: Path) -> None:
        text = (scene / name).read_text()
        assert old in text
        (scene / name).write_text(text.replace(old, new, 1))

    return change


def _times(edit: Callable[[dict], object]) -> Damage:
    def change(scene: Path) -> None:
        times = json.loads((scene / "timestamps.json").read_text())
        edit(times)
        (scene / "timestamps.json").write_text(json.dumps(times))

    return change


def _pickled_points(scene: Path) -> None:
    frames = {0: np.ones((3, 3)), 1: np.ones((3, 3))}  # as the original preprocessing writes it
    np.savez(scene / "pointcloud.npz", pointcloud=np.array(frames, object))


def _points(**arrays: np.ndarray) -> Damage:
    return lambda scene: np.savez(scene / "pointcloud.npz", **arrays)


def _matrix(name: str, matrix: np.ndarray) -> Damage:
    return lambda scene: tiny.write_matrix(scene / name, matrix)


def _bomb(side: int) -> bytes:
    """The beginning of a PNG file of side x side pixels, which nobody may decode."""
    header = b"IHDR" + struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    data = b"IDAT" + zlib.compress(bytes(1000))
    chunks = [header, data, b"IEND"]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
        for chunk in chunks
    )


TRACKS = "track/track_info.txt"


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (
            _pickled_points,
            "pointcloud.npz: array pointcloud: holds pickled Python objects, which are never",
        ),
        (
            lambda s: (s / "pointcloud.npz").write_bytes(b"cos\nsystem\n(S'false'\ntR."),
            "pointcloud.npz: file: is not an .npz archive; pickles are never loaded",
        ),
        (_points(a=np.zeros((3, 3))), "pointcloud.npz: array a: is not a frame"),
        (_points(**{"000099": np.zeros((3, 3))}), "array 000099: is not a frame"),
        (_points(**{"000001": np.zeros((3, 4))}), "array 000001: is float64 of shape (3, 4)"),
        (lambda s: (s / "timestamps.json").unlink(), "timestamps.json: file: is missing"),
        (_times(lambda t: t.pop("FRONT")), "timestamps.json: FRONT.000000: is missing"),
        (_times(lambda t: t["FRAME"].pop("000004")), "timestamps.json: FRAME.000004: is missing"),
        (
            _times(lambda t: t["FRAME"].update({"000004": "noon"})),
            'timestamps.json: FRAME.000004: "noon" is not a time',
        ),
        (
            _times(lambda t: t["FRAME"].update({"000004": t["FRAME"]["000003"]})),
            "timestamps.json: FRAME.000004: is not later than the frame before",
        ),
        (
            _times(lambda t: t["FRONT"].update({"000004": t["FRONT"]["000003"]})),
            "timestamps.json: FRONT.000004: is the time of another image",
        ),
        (lambda s: (s / "ego_pose/000004_1.txt").unlink(), "ego_pose/000004_1.txt: file: is miss"),
        (
            _matrix("ego_pose/000004_1.txt", np.eye(4)),
            "ego_pose/000004_1.txt: matrix: is 26218 m from the image before: mixed",
        ),
        (
            _matrix("ego_pose/000004.txt", np.eye(4)),
            "ego_pose/000004.txt: matrix: is 26218 m from the path of the images: mixed",
        ),
        (_matrix("ego_pose/000004.txt", np.ones((4, 4))), "000004.txt: matrix: is not a rotation"),
        (_matrix("ego_pose/000004.txt", np.ones(15)), "16 finite numbers are needed, got 15"),
        (lambda s: (s / "extrinsics/1.txt").unlink(), "extrinsics/1.txt: file: is missing"),
        (lambda s: (s / "intrinsics/0.txt").unlink(), "intrinsics/0.txt: file: is missing"),
        (
            lambda s: (s / "intrinsics/0.txt").write_text("a b c"),
            "intrinsics/0.txt: numbers: cannot be read",
        ),
        (_matrix("intrinsics/0.txt", -np.array(tiny.INTRINSIC)), "intrinsics/0.txt: numbers: Pin"),
        (
            lambda s: (s / "images/000001_0.png").rename(s / "images/front.png"),
            "images/front.png: file name: is not FRAME_CAMERA.png",
        ),
        (
            lambda s: (s / "images/000001_0.png").write_bytes(b"\x89PNG"),
            "images/000001_0.png: image: cannot be decoded",
        ),
        (
            lambda s: (s / "images/000001_0.png").write_bytes(_bomb(30_000)),
            "images/000001_0.png: size: is 30000x30000, more than 134 megapixels",
        ),
        (
            lambda s: (s / "images/000000_0.png").write_bytes(_bomb(100_000)),
            "images/000000_0.png: size: is 100000x100000, more than 134 megapixels",
        ),
        (_points(**{"\u00b2": np.zeros((3, 3))}), "pointcloud.npz: array \u00b2: is not a frame"),
        (_points(**{"000001": np.full((3, 3), 1e300)}), "array 000001: holds a point not within"),
        (
            _times(lambda t: t["FRONT"].update({"000004": 1e18})),
            "timestamps.json: FRONT.000004: 1e+18 is not a time",
        ),
        (lambda s: (s / TRACKS).unlink(), f"{TRACKS}: file: is missing"),
        (_edit(TRACKS, " 9.0", " 9.0 1 2"), f"{TRACKS}: line 2: has 14 columns, not 11 or 12"),
        (_edit(TRACKS, "vehicle", "boat"), f"{TRACKS}: line 2: class: 'boat' is unknown"),
        (_edit(TRACKS, "0 1.5", "0 tall"), f"{TRACKS}: line 2: contains text where"),
        (_edit(TRACKS, "0 1.5", "0 1e200"), f"{TRACKS}: line 2: holds NaN or infinity, or a num"),
        (_edit(TRACKS, "0 1.5", "0 -1.5"), f"{TRACKS}: line 2: size: is not a valid box size"),
        (_edit(TRACKS, "\n1 7", "\n99 7"), f"{TRACKS}: line 4: frame: 99 has no ego_pose"),
        (_edit(TRACKS, "\n1 7", "\n0 7"), f"{TRACKS}: line 4: track: track 7 appears twice"),
        (
            _edit(TRACKS, "1.5 1.8 4.0 1", "1.5 1.8 4.0 -9991"),
            f"{TRACKS}: line 2: centre: the box is 9",
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
        import_drive("street-gaussians", tmp_path, tiny.SCENE, tmp_path / "out" / "log")
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "out").exists() or list((tmp_path / "out").iterdir()) == []


def test_a_scene_that_is_not_there_is_answered_with_those_that_are(tiny_root: Path) -> None:
    with pytest.raises(InputError, match="drive 031: does not exist; choose one of 002"):
        load_street_gaussians(tiny_root, "031")
