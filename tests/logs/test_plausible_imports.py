"""Faults in the files of datasets: each importer's log is right, or the fault is told."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import load_log, plausibility
from recast_bridges.logs.processed_folder import read_cameras
from support import tiny_drive, tiny_processed
from support import tiny_nuscenes as nuscenes
from support.tiny_drive import DRIVE, TinyDrive

Row = dict[str, list[float]]


@pytest.fixture(scope="module")
def nuscenes_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("nuscenes")
    nuscenes.write_tiny_nuscenes(root)
    return root


def _xyzw(row: Row) -> None:
    row["rotation"] = [*row["rotation"][1:], row["rotation"][0]]


def _inverted(row: Row) -> None:
    rotation = se3.quat_to_matrix(row["rotation"]).T
    row["rotation"] = se3.matrix_to_quat(rotation).tolist()
    row["translation"] = (-rotation @ row["translation"]).tolist()


def _compass(row: Row) -> None:
    w, _, _, z = row["rotation"]
    half = np.pi / 4 - np.arctan2(z, w)
    row["rotation"] = [np.cos(half), 0.0, 0.0, np.sin(half)]


def _degrees(row: Row) -> None:
    w, _, _, z = row["rotation"]
    half = np.degrees(2 * np.arctan2(z, w)) / 2
    row["rotation"] = [np.cos(half), 0.0, 0.0, np.sin(half)]


def _exchanged(row: Row) -> None:
    x, y, z = row["translation"]
    row["translation"] = [y, x, z]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_xyzw, r"the rig leans by 30 degrees from the world's up; are quaternions wxyz\?"),
        (_inverted, r"the rig faces \d+ degrees away from its direction of motion; .*not inverted"),
        (
            _compass,
            r"the rig faces 30 degrees away from its direction of motion; is the yaw counter-clock",
        ),
        (_degrees, r"the rig faces \d+ degrees away from its direction of motion; .*radians"),
        (
            _exchanged,
            r"the rig faces 30 degrees away from its direction of motion; .*latitude before",
        ),
    ],
)
def test_ego_poses_of_nuscenes(
    nuscenes_root: Path, tmp_path: Path, change: Callable[[Row], None], words: str
) -> None:
    shutil.copytree(nuscenes_root, tmp_path, dirs_exist_ok=True)
    for name in ("ego_pose", "sample_annotation"):
        rows = nuscenes.read_table(tmp_path / nuscenes.VERSION, name)
        for row in rows:
            change(row)
        nuscenes.write_table(tmp_path / nuscenes.VERSION, name, rows)
    with pytest.raises(InputError) as caught:
        load_log(tmp_path, importer="nuscenes", drive=nuscenes.SCENE)
    assert re.search(words, str(caught.value)), caught.value


@pytest.mark.filterwarnings("ignore::recast.logs.OddLogWarning")
def test_flips_of_key_frames_are_turned_before_they_are_interpolated(
    nuscenes_root: Path, tmp_path: Path
) -> None:
    good = load_log(nuscenes_root, importer="nuscenes", drive=nuscenes.SCENE).tracks["car"]
    shutil.copytree(nuscenes_root, tmp_path, dirs_exist_ok=True)
    rows = nuscenes.read_table(tmp_path / nuscenes.VERSION, "sample_annotation")
    labels = sorted((row for row in rows if row["instance_token"] == "car"), key=str)
    for row in labels[1::2]:
        w, x, y, z = row["rotation"]
        row["rotation"] = [-z, -y, x, w]
    nuscenes.write_table(tmp_path / nuscenes.VERSION, "sample_annotation", rows)
    log = load_log(tmp_path, importer="nuscenes", drive=nuscenes.SCENE)
    np.testing.assert_allclose(log.tracks["car"].trajectory.poses, good.trajectory.poses, atol=1e-9)
    assert any("2 of 5 labels of car" in told for told in plausibility(log).warnings)

    labels[2]["translation"][0] += 40.0
    nuscenes.write_table(tmp_path / nuscenes.VERSION, "sample_annotation", rows)
    log = load_log(tmp_path, importer="nuscenes", drive=nuscenes.SCENE)
    told = plausibility(log, sensors=False).warnings
    assert any("1 of 2 tracks jump" in sentence and "car by 4" in sentence for sentence in told)


def test_a_kitti_car_that_rolls_backwards_keeps_its_cameras(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tiny_drive, "EGO_SPEED", -3.5)
    monkeypatch.setattr(tiny_drive, "FRAMES", 12)
    drive = tiny_drive.write_tiny_drive(tmp_path)
    log = load_log(drive.root, importer="kitti", drive=DRIVE)
    camera = log.cameras["image_02"].rig_from_camera
    np.testing.assert_allclose(camera[:3, 2], [1.0, 0.0, 0.0], atol=1e-2)
    assert camera[0, 3] > 1.0
    assert plausibility(log).warnings == ()
    assert plausibility(log).figures.reversing == 1.0


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({5: lambda v: np.degrees(v[5])}, "degrees away from its direction of motion"),
        ({5: lambda v: np.pi / 2 - v[5]}, "faces 30 degrees away .* counter-clockwise from east"),
        ({0: lambda v: v[1], 1: lambda v: v[0]}, "degrees away .* latitude before longitude"),
    ],
    ids=["degrees", "compass", "exchanged"],
)
def test_oxts_of_kitti(
    tiny_drive: TinyDrive,
    tmp_path: Path,
    columns: dict[int, Callable[[list[float]], float]],
    words: str,
) -> None:
    shutil.copytree(tiny_drive.root, tmp_path, dirs_exist_ok=True)
    for path in (tmp_path / tiny_drive.folder.relative_to(tiny_drive.root)).glob("oxts/data/*"):
        values = [float(word) for word in path.read_text().split()]
        changed = {column: change(values) for column, change in columns.items()}
        path.write_text(" ".join(f"{changed.get(i, v):.15g}" for i, v in enumerate(values)))
    with pytest.raises(InputError) as caught:
        load_log(tmp_path, importer="kitti", drive=DRIVE, refine=False, with_map=False)
    assert re.search(words, str(caught.value)), caught.value


@pytest.mark.filterwarnings("ignore::recast.logs.OddLogWarning")
@pytest.mark.parametrize(
    ("importer", "write"),
    [
        ("drivestudio", tiny_processed.write_drivestudio),
        ("street-gaussians", tiny_processed.write_street_gaussians),
    ],
)
def test_intrinsics_follow_images_of_half_the_size(
    tmp_path: Path, importer: str, write: Callable[[Path], Path]
) -> None:
    scene = write(tmp_path)
    whole = load_log(tmp_path, importer=importer, drive=tiny_processed.SCENE)
    for path in (scene / "images").iterdir():
        with Image.open(path) as image:
            image.resize((image.width // 2, image.height // 2)).save(path)
    half = load_log(tmp_path, importer=importer, drive=tiny_processed.SCENE)
    for name, stream in whole.cameras.items():
        assert half.cameras[name].camera == stream.camera.resized(32, 24)
    assert any("FRONT by 0.5" in told for told in plausibility(half).warnings)
    for path in (scene / "images").iterdir():
        with Image.open(path) as image:
            image.resize((64, 24)).save(path)
    for path in (scene / "intrinsics").iterdir():
        values = np.loadtxt(path)
        np.savetxt(path, values * np.where(np.arange(9) < 4, 2.0, 1.0))
    with pytest.raises(InputError, match=r"the principal point 65, 46 is not in the middle half"):
        load_log(tmp_path, importer=importer, drive=tiny_processed.SCENE)


@pytest.mark.parametrize("width", [960, 1280, 1920])
def test_waymo_images_of_any_size_have_their_intrinsics(tmp_path: Path, width: int) -> None:
    """A side camera's principal point lies high above the middle: its images are cut below."""
    recorded = {0: (1920, 1280, 950.0, 633.0), 3: (1920, 886, 968.0, 247.0)}
    (tmp_path / "images").mkdir()
    for number, (long, high, cx, cy) in recorded.items():
        size = (width, round(width * high / long))
        Image.new("RGB", size).save(tmp_path / f"images/000_{number}.png")
        tiny_processed.write_matrix(tmp_path / f"extrinsics/{number}.txt", np.eye(4))
        numbers = np.array([2050.0, 2050.0, cx, cy, 0.0, 0.0, 0.0, 0.0, 0.0])
        tiny_processed.write_matrix(tmp_path / f"intrinsics/{number}.txt", numbers)
    for folder in read_cameras(tmp_path):
        _, _, cx, cy = recorded[folder.number]
        by = width / 1920
        camera = folder.camera
        expected = [2050 * by, cx * by, cy * by]
        np.testing.assert_allclose([camera.fx, camera.cx, camera.cy], expected, rtol=2e-3)
