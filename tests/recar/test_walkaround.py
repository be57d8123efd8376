"""Walk-arounds: poses, azimuths, and the photographs that are taken."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from recast.cli.main import main
from recast.core.errors import InputError
from recast.geometry import se3
from recast.recar.ingest import IngestReport, ingest_photographs
from recast.recar.ingest_folder import around, read_poses
from recast.recar.ingest_table import IngestSettings
from recast.recar.views import camera_pose
from support.vehicle_photographs import HEIGHT, SETTINGS, VIEWS, WIDTH, photograph, write_rows

COUNT, FRONT = 23, 5  # photographs, and the number of the one ahead of the vehicle
ANGLES = (np.arange(COUNT) * 360 / COUNT + 3 * np.sin(np.arange(COUNT))) % 360
WALK = replace(SETTINGS, layout="mad-cars")


def ring(angles: np.ndarray = ANGLES, seed: int = 0) -> np.ndarray:
    """Poses in a world of any orientation and unit; cameras at several heights that look askew."""
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    world = se3.from_rotation_translation(turn, rng.normal(size=3))
    poses = []
    for index, angle in enumerate(angles):
        pose = camera_pose(angle, 12 + 4 * np.sin(7 * index), 3.0 + 0.5 * np.cos(index))
        poses.append(world @ pose)
    return np.stack(poses)


def write_walk(photos: Path, name: str = "car-a", masks: bool = True) -> Path:
    """Photographs without alpha, their masks, and transforms.json."""
    folder = photos / name
    (folder / "images").mkdir(parents=True)
    frames = []
    for index, pose in enumerate(ring()):
        rgba = photograph(index)
        file = f"{index + 1:03d}.png"
        Image.fromarray(rgba[..., :3]).save(folder / "images" / file)
        if masks:
            (folder / "masks").mkdir(exist_ok=True)
            Image.fromarray(rgba[..., 3]).save(folder / "masks" / file)
        matrix = pose @ np.diag([1.0, -1.0, -1.0, 1.0])
        frames.append({"file_path": f"./images/{file}", "transform_matrix": matrix.tolist()})
    (folder / "transforms.json").write_text(json.dumps({"camera_angle_x": 0.7, "frames": frames}))
    write_rows(photos, [{"id": name, "kind": "suv", "front": FRONT}])
    return folder


def to_colmap(folder: Path, place: str = "sparse/0/images.txt") -> None:
    """The same poses as COLMAP writes them."""
    poses = read_poses(folder)
    assert poses is not None
    (folder / "transforms.json").unlink()
    lines = ["# Image list with two lines of data per image:"]
    for number, (name, pose) in enumerate(poses.items(), 1):
        inverse = se3.inverse(pose)
        quat = se3.matrix_to_quat(inverse[:3, :3])
        words = [number, *quat.tolist(), *inverse[:3, 3].tolist(), 1, f"images/{name}"]
        lines += [" ".join(map(str, words)), "" if number % 2 else "1.5 2.5 -1"]
    path = folder / place
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")


def ingest(photos: Path, out: Path, walk: IngestSettings = WALK) -> IngestReport:
    return ingest_photographs(photos, out, walk, None)


@given(st.integers(0, 2**32), st.integers(0, COUNT - 1))
@settings(max_examples=40, deadline=None)
def test_azimuths_in_any_world(seed: int, front: int) -> None:
    found, elevations = around(ring(seed=seed), front)
    off = (found - (ANGLES - ANGLES[front]) + 180) % 360 - 180
    # the heights of the cameras are not symmetric, so the ring's plane is tilted a little
    assert np.abs(off).max() < 2.0
    assert elevations.min() > 4 and elevations.max() < 20


def test_level_cameras_are_found_exactly() -> None:
    poses = np.stack([camera_pose(angle, 15.0, 6.0) for angle in ANGLES])
    found, elevations = around(poses, 0)
    np.testing.assert_allclose((found - ANGLES + ANGLES[0] + 180) % 360, 180, atol=1e-9)
    np.testing.assert_allclose(elevations, 15.0, atol=1e-9)


@pytest.mark.parametrize("layout", ["3drealcar", "mad-cars"])
@pytest.mark.parametrize("colmap", [None, "images.txt", "sparse/0/images.txt"])
def test_a_walk_becomes_regular_views(tmp_path: Path, layout: str, colmap: str | None) -> None:
    folder = write_walk(tmp_path / "photos")
    if colmap:
        to_colmap(folder, colmap)
    report = ingest(tmp_path / "photos", tmp_path / "set", replace(WALK, layout=layout))
    identity = report.vehicle_set.identities["car-a"]
    assert report.vehicle_set.record.views == VIEWS
    seen = (ANGLES - ANGLES[FRONT - 1]) % 360
    for view in range(VIEWS):
        off = np.abs((seen - 90 * view + 180) % 360 - 180)
        near = np.flatnonzero(off < 12)  # several: of these the one at the usual elevation
        pictures = [photograph(int(index)) for index in near]
        assert any(np.array_equal(identity.view(view), one) for one in pictures)
    assert np.array_equal(identity.view(0), photograph(FRONT - 1))
    (doubts,) = report.doubts.values()
    assert any(f"a photograph is {WIDTH}x{HEIGHT}" in one for one in doubts)
    assert any("elevations are" in one for one in doubts)


def test_measured_azimuths_need_no_poses_and_no_front(tmp_path: Path) -> None:
    folder = write_walk(tmp_path / "photos")
    (folder / "transforms.json").unlink()
    told = " ".join(f"{angle:.2f}" for angle in ANGLES)
    write_rows(tmp_path / "photos", [{"id": "car-a", "kind": "suv", "azimuths_deg": told}])
    made = ingest(tmp_path / "photos", tmp_path / "set").vehicle_set
    for view in range(VIEWS):
        nearest = int(np.argmin(np.abs((ANGLES - 90 * view + 180) % 360 - 180)))
        assert np.array_equal(made.identities["car-a"].view(view), photograph(nearest))


def no_poses(folder: Path) -> None:
    (folder / "transforms.json").unlink()


def two_files_of_poses(folder: Path) -> None:
    (folder / "images.txt").write_text("")


def a_sheared_pose(folder: Path) -> None:
    record = json.loads((folder / "transforms.json").read_text())
    record["frames"][3]["transform_matrix"][0][1] += 0.2
    (folder / "transforms.json").write_text(json.dumps(record))


def a_pose_twice(folder: Path) -> None:
    record = json.loads((folder / "transforms.json").read_text())
    record["frames"].append(record["frames"][0])
    (folder / "transforms.json").write_text(json.dumps(record))


def words_for_poses(folder: Path) -> None:
    (folder / "transforms.json").unlink()
    (folder / "images.txt").write_text("1 nan 0 0 0 0 0 0 1 a.jpg\n\n")


def a_few_words(folder: Path) -> None:
    (folder / "transforms.json").unlink()
    (folder / "images.txt").write_text("1 1 0 0 0\n\n")


def half_a_ring(folder: Path) -> None:
    for index in range(COUNT // 2):
        (folder / "images" / f"{(FRONT + 2 + index) % COUNT + 1:03d}.png").unlink()


def all_in_one_place(folder: Path) -> None:
    record = json.loads((folder / "transforms.json").read_text())
    for frame in record["frames"]:
        frame["transform_matrix"] = record["frames"][0]["transform_matrix"]
    (folder / "transforms.json").write_text(json.dumps(record))


def no_front(folder: Path) -> None:
    write_rows(folder.parent, [{"id": "car-a", "kind": "suv"}])


def front_too_high(folder: Path) -> None:
    write_rows(folder.parent, [{"id": "car-a", "kind": "suv", "front": COUNT + 1}])


def small_mask(folder: Path) -> None:
    for path in (folder / "masks").iterdir():
        Image.fromarray(np.full((4, 4), 255, np.uint8)).save(path)


def a_folder_outside(folder: Path) -> None:
    write_rows(folder.parent, [{"id": "car-a", "folder": "../car-a", "kind": "suv", "front": 1}])


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (no_poses, "poses: are missing"),
        (two_files_of_poses, "are in transforms.json and in images.txt"),
        (a_sheared_pose, "004.png: has a pose that is not a rotation"),
        (a_pose_twice, "001.png: has two poses"),
        (words_for_poses, "photograph 1: has a pose that is not finite"),
        (a_few_words, "photograph 1: has 5 words"),
        (half_a_ring, "no photograph is within"),
        (all_in_one_place, "are not in a ring"),
        (no_front, "front: is missing: poses do not say"),
        (front_too_high, "front: is 24"),
        (small_mask, "size: is 4x4, the photograph 60x40"),
        (a_folder_outside, "not a file inside of photos"),
    ],
)
def test_what_is_refused(tmp_path: Path, change: Callable[[Path], None], problem: str) -> None:
    change(write_walk(tmp_path / "photos"))
    with pytest.raises(InputError, match="cannot be used") as caught:
        ingest(tmp_path / "photos", tmp_path / "set")
    report = tmp_path / "set" / "ingest.json"
    told = f"{caught.value} {report.read_text() if report.is_file() else ''}"
    assert problem.split(": ")[-1] in told


def test_without_masks_a_remover_is_needed(tmp_path: Path) -> None:
    write_walk(tmp_path / "photos", masks=False)
    with pytest.raises(InputError, match="alpha: is absent"):
        ingest(tmp_path / "photos", tmp_path / "set")


def test_the_command_says_that_the_layout_is_experimental(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_walk(tmp_path / "photos")
    args = ["recar", "ingest", str(tmp_path / "photos"), "--out", str(tmp_path / "set")]
    args += ["--licence", "CC-BY-4.0", "--layout", "3drealcar", "--views", "4"]
    args += ["--width", str(WIDTH), "--height", str(HEIGHT), "--remover", "none"]
    assert main(args) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "3drealcar is experimental, it has not met real data" in told
    assert "1 identities, 0 left out, 1 to look at" in told
    args[4] = str(tmp_path / "other")
    assert main([*args, "--azimuth-within", "0.001"]) == 2
    assert "no photograph is within 0.001 degrees of 90" in " ".join(
        capsys.readouterr().err.split()
    )
    with pytest.raises(InputError, match="`layout`: diorama: is unknown"):
        replace(WALK, layout="diorama").validate()
