"""Text and image files as people have them: empty lines, line ends, marks, comments, suffixes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from recast.core.errors import InputError
from recast.core.files import read_json, read_text
from recast.logs import DrivingLog, load_log
from recast.logs.importers.kitti_files import MISSING, read_timestamps, turn_times
from support import tiny_argoverse2, tiny_drive, tiny_nuscenes, tiny_processed

TIMES = "velodyne_points/timestamps.txt"


def _kitti(root: Path) -> DrivingLog:
    return load_log(
        root,
        importer="kitti",
        drive=tiny_drive.DRIVE,
        labels=root / "labels.txt",
        refine=False,
        with_map=False,
    )


def _without_line(path: Path, line: int) -> None:
    lines = path.read_text().splitlines()
    lines[line] = ""
    path.write_text("\n".join(lines) + "\n")


def test_an_empty_line_of_kitti_is_a_scan_that_is_missing(tmp_path: Path) -> None:
    drive = tiny_drive.write_tiny_drive(tmp_path)
    whole, times = _kitti(tmp_path), turn_times(drive.folder / "velodyne_points")
    for path in (drive.folder / "velodyne_points").glob("timestamps*.txt"):
        _without_line(path, 3)  # of which there is no sweep
        _without_line(path, 0)
    (drive.folder / "velodyne_points/data/0000000000.bin").unlink()
    assert read_timestamps(drive.folder / TIMES)[[0, 3]].tolist() == [MISSING, MISSING]
    found = turn_times(drive.folder / "velodyne_points")
    np.testing.assert_allclose(found, times, atol=2)
    log = _kitti(tmp_path)
    lidars = log.lidars["velodyne"], whole.lidars["velodyne"]
    np.testing.assert_array_equal(lidars[0].timestamps_us, lidars[1].timestamps_us[1:])
    np.testing.assert_allclose(
        log.cameras["image_02"].timestamps_us, whole.cameras["image_02"].timestamps_us, atol=2
    )
    assert log.tracks.keys() == whole.tracks.keys()


def test_a_scan_without_its_time_is_refused(tmp_path: Path) -> None:
    drive = tiny_drive.write_tiny_drive(tmp_path)
    _without_line(drive.folder / TIMES, 4)
    with pytest.raises(
        InputError, match=r"line 5: is empty, but the frame has the file 0000000004\.bin"
    ):
        _kitti(tmp_path)


def _edited(path: Path, edit: Callable[[str], str]) -> None:
    path.write_bytes(edit(path.read_text()).encode())


EDITS: dict[str, Callable[[str], str]] = {
    "marked": lambda text: "\ufeff" + text,
    "CRLF": lambda text: text.replace("\n", "\r\n"),
    "empty lines at the end": lambda text: text + "\n \n\n",
}


@pytest.mark.parametrize("edit", EDITS.values(), ids=EDITS)
def test_text_of_kitti_may_have_been_through_an_editor(
    edit: Callable[[str], str], tmp_path: Path
) -> None:
    drive = tiny_drive.write_tiny_drive(tmp_path)
    texts = [*drive.folder.rglob("timestamps*.txt"), *(drive.folder / "oxts/data").glob("*3.txt")]
    for path in (*texts, *(tmp_path / tiny_drive.DATE).glob("calib*.txt"), drive.labels):
        _edited(path, edit)
    log = _kitti(tmp_path)
    assert len(log.lidars["velodyne"].timestamps_us) == 12 and len(log.tracks) == 2


@pytest.mark.parametrize(
    "edit",
    [*EDITS.values(), lambda text: "# made by a tool\n\n" + text],
    ids=[*EDITS, "comment"],
)
@pytest.mark.parametrize("kind", ["street-gaussians", "drivestudio"])
def test_text_of_processed_scenes_may_have_been_through_an_editor(
    kind: str, edit: Callable[[str], str], tmp_path: Path
) -> None:
    write = getattr(tiny_processed, f"write_{kind.replace('-', '_')}")
    scene = write(tmp_path)
    before = load_log(tmp_path, importer=kind, drive=tiny_processed.SCENE)
    for path in scene.rglob("*.txt"):
        _edited(path, edit)
    log = load_log(tmp_path, importer=kind, drive=tiny_processed.SCENE)
    np.testing.assert_array_equal(log.world_from_rig.poses, before.world_from_rig.poses)
    for key, track in before.tracks.items():
        found = log.tracks[key].trajectory
        np.testing.assert_array_equal(found.timestamps_us, track.trajectory.timestamps_us)


def test_boxes_without_a_line_of_names_keep_their_first(tmp_path: Path) -> None:
    scene = tiny_processed.write_street_gaussians(tmp_path)
    read = {"importer": "street-gaussians", "drive": tiny_processed.SCENE}
    before = load_log(tmp_path, **read)
    _edited(scene / "track/track_info.txt", lambda text: text.partition("\n")[2])
    assert _labels(load_log(tmp_path, **read)) == _labels(before)


def _labels(log: DrivingLog) -> dict[str, int]:
    return {key: len(track.trajectory.timestamps_us) for key, track in log.tracks.items()}


def test_a_byte_order_mark_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_bytes("\ufeff[1]".encode())
    assert read_text(path) == "[1]" and read_json(path) == [1]


def test_tables_of_nuscenes_may_begin_with_a_mark(tmp_path: Path) -> None:
    tables = tiny_nuscenes.write_tiny_nuscenes(tmp_path)
    tables = tables if tables.name.startswith("v1.0") else tmp_path / "v1.0-mini"
    for path in tables.glob("*.json"):
        _edited(path, EDITS["marked"])
    assert load_log(tmp_path, importer="nuscenes", drive=tiny_nuscenes.SCENE).tracks


@pytest.mark.parametrize("suffix", [".png", ".JPG", ".Jpeg"])
def test_images_of_any_suffix_are_read(suffix: str, tmp_path: Path) -> None:
    cameras = tiny_argoverse2.write_tiny_log(tmp_path / "av2") / "sensors/cameras"
    scene = tiny_processed.write_drivestudio(tmp_path / "processed")
    drive = tiny_drive.write_tiny_drive(tmp_path / "kitti")
    folders = scene / "images", drive.folder / "image_02/data", *cameras.glob("*")
    for path in [path for folder in folders for path in folder.iterdir()]:
        if suffix == ".png":
            cv2.imwrite(str(path.with_suffix(suffix)), cv2.imread(str(path)))
        else:
            path.with_suffix(suffix).write_bytes(path.read_bytes())
        if path.suffix != suffix:
            path.unlink()
    logs = [
        load_log(tmp_path / "av2", importer="argoverse2", drive=tiny_argoverse2.LOG),
        load_log(tmp_path / "processed", importer="drivestudio", drive=tiny_processed.SCENE),
        _kitti(tmp_path / "kitti"),
    ]
    for log in logs:
        counts = [len(camera.images) for camera in log.cameras.values()]
        assert sum(counts) == len(set(_images(log))) > 0


def _images(log: DrivingLog) -> list[Path]:
    return [path for camera in log.cameras.values() for path in camera.images.paths]


def test_two_images_of_a_frame_are_refused(tmp_path: Path) -> None:
    scene = tiny_processed.write_drivestudio(tmp_path)
    (scene / "images/003_0.png").write_bytes((scene / "images/003_0.jpg").read_bytes())
    with pytest.raises(InputError, match=r"003_0\.png: file name: is the same frame as 003_0\.jpg"):
        load_log(tmp_path, importer="drivestudio", drive=tiny_processed.SCENE)


@pytest.mark.parametrize("name", [tiny_drive.DRIVE, f"{tiny_drive.DRIVE}_extract"])
def test_drives_of_kitti_as_recorded_are_refused_with_a_clear_word(
    name: str, tmp_path: Path
) -> None:
    drive = tiny_drive.write_tiny_drive(tmp_path)
    drive.folder.rename(drive.folder.with_name(f"{tiny_drive.DRIVE}_extract"))
    wanted = rf"_extract: drive: is the raw recording: .*; use {tiny_drive.DRIVE}_sync"
    with pytest.raises(InputError, match=wanted):
        load_log(tmp_path, importer="kitti", drive=name)
