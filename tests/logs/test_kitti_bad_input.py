"""Bad KITTI input: one line that names the file, the field and the mend, and nothing written."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from recast.errors import InputError
from recast.logs.importers.kitti import import_kitti
from support import tiny_drive as tiny

Damage = Callable[[tiny.TinyDrive], object]


@pytest.fixture
def drive(tiny_drive: tiny.TinyDrive, tmp_path: Path) -> tiny.TinyDrive:
    """A copy that may be broken."""
    shutil.copytree(tiny_drive.root, tmp_path / "kitti")
    return tiny.TinyDrive(tmp_path / "kitti", tmp_path / "kitti" / "labels.txt")


def _cut(path: Path, missing: int) -> None:
    path.write_bytes(path.read_bytes()[:-missing])


def _replace(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def _swap_lines(path: Path, first: int, second: int) -> None:
    lines = path.read_text().splitlines()
    lines[first], lines[second] = lines[second], lines[first]
    path.write_text("\n".join(lines) + "\n")


def _move_boxes(path: Path, metres: float) -> None:
    """What labels of another drive look like: boxes, but not where anything is."""
    rows = [line.split() for line in path.read_text().splitlines()]
    for row in rows:
        if row[2] != "DontCare":
            row[13], row[15] = str(float(row[13]) * -0.4), str(float(row[15]) + metres)
    path.write_text("\n".join(" ".join(row) for row in rows) + "\n")


def _calibration(drive: tiny.TinyDrive, name: str) -> Path:
    return drive.root / tiny.DATE / name


CASES: dict[str, tuple[Damage, str]] = {
    "no calibration": (
        lambda d: _calibration(d, "calib_velo_to_cam.txt").unlink(),
        "calib_velo_to_cam.txt: calibration file: is missing; unpack the day's calibration",
    ),
    "calibration without a field": (
        lambda d: _replace(_calibration(d, "calib_cam_to_cam.txt"), "P_rect_02", "P_02"),
        "calib_cam_to_cam.txt: P_rect_02: is missing",
    ),
    "calibration cut off": (
        lambda d: _cut(_calibration(d, "calib_imu_to_velo.txt"), 14),
        "calib_imu_to_velo.txt: T: expected 3 numbers, found 2",
    ),
    "truncated sweep": (
        lambda d: _cut(d.folder / "velodyne_points/data/0000000004.bin", 5),
        "0000000004.bin: points: ",
    ),
    "empty sweep": (
        lambda d: (d.folder / "velodyne_points/data/0000000004.bin").write_bytes(b""),
        "0000000004.bin: points: 0 bytes",
    ),
    "truncated image": (
        lambda d: _cut(d.folder / "image_02/data/0000000007.png", 900),
        "0000000007.png: image: cannot be decoded",
    ),
    "not an image": (
        lambda d: (d.folder / "image_02/data/0000000007.png").write_text("no"),
        "0000000007.png: image: cannot be decoded",
    ),
    "image of another size": (
        lambda d: _replace(
            _calibration(d, "calib_cam_to_cam.txt"), "S_rect_02: 1.6", "S_rect_02: 1.7"
        ),
        "image size: is 160x48, calib_cam_to_cam.txt says 170x48",
    ),
    "labels of another drive": (
        lambda d: _move_boxes(d.labels, 4.0),
        "labels.txt: boxes: ",
    ),
    "labels of a longer drive": (
        lambda d: _replace(d.labels, "\n23 0 Car", "\n230 0 Car"),
        "labels.txt: track 0: frame 230, but the drive has 30 frames",
    ),
    "labels with too few columns": (
        lambda d: d.labels.write_text("0 0 Car 0 0\n"),
        "labels.txt: line 1: 5 of 17 columns",
    ),
    "labels of an unknown type": (
        lambda d: _replace(d.labels, "3 0 Car", "3 0 Boat"),
        "unknown type 'Boat'",
    ),
    "labels that do not exist": (
        lambda d: d.labels.unlink(),
        "labels.txt: file: is missing",
    ),
    "timestamps out of order": (
        lambda d: _swap_lines(d.folder / "image_02/timestamps.txt", 4, 5),
        "image_02/timestamps.txt: line 6: is not later than line 5",
    ),
    "oxts timestamps out of order": (
        lambda d: _swap_lines(d.folder / "oxts/timestamps.txt", 4, 5),
        "oxts/timestamps.txt: line 6: is not later than line 5",
    ),
    "too few timestamps": (
        lambda d: _cut(d.folder / "image_02/timestamps.txt", 30 * 20),
        "image_02/timestamps.txt: line 24: is missing",
    ),
    "a timestamp that is none": (
        lambda d: _replace(d.folder / "oxts/timestamps.txt", "2011-09-26 13:02:26.08", "yesterday"),
        "is not a time",
    ),
    "oxts with too few fields": (
        lambda d: (d.folder / "oxts/data/0000000003.txt").write_text("49.0 8.4 112.0\n"),
        "0000000003.txt: fields: 3 of 30 numbers",
    ),
    "oxts that are no numbers": (
        lambda d: (d.folder / "oxts/data/0000000003.txt").write_text("<html>"),
        "0000000003.txt: numbers: cannot be read",
    ),
    "oxts with a long gap": (
        lambda d: [(d.folder / f"oxts/data/{i:010d}.txt").unlink() for i in range(5, 18)],
        "0000000018.txt: packets before it: are missing for 1.4 s",
    ),
    "no images": (
        lambda d: shutil.rmtree(d.folder / "image_02"),
        "cameras: image_00 to image_03 are missing",
    ),
    "no such drive": (
        lambda d: d.folder.rename(d.folder.with_name("2011_09_26_drive_0002_sync")),
        "choose one of 2011_09_26_drive_0002_sync",
    ),
    "no such folder": (
        lambda d: shutil.rmtree(d.root),
        "KITTI folder: does not exist",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_one_clear_line(drive: tiny.TinyDrive, tmp_path: Path, case: str) -> None:
    damage, message = CASES[case]
    damage(drive)
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(InputError) as error:
        import_kitti(drive.root, tiny.DRIVE, out / "log", drive.labels, refine=False)
    assert message in str(error.value)
    assert "\n" not in str(error.value)
    assert list(out.iterdir()) == []


def test_an_existing_output_folder_is_refused_at_once(
    drive: tiny.TinyDrive, tmp_path: Path
) -> None:
    (tmp_path / "log").mkdir()
    with pytest.raises(InputError, match="output folder: exists already"):
        import_kitti(drive.root, tiny.DRIVE, tmp_path / "log", drive.labels)


def test_broken_tracklets(drive: tiny.TinyDrive, tmp_path: Path) -> None:
    path = tmp_path / "tracklet_labels.xml"
    tiny.write_tracklets(path)
    _replace(path, "<l>4.2</l>", "")
    with pytest.raises(InputError, match=r"tracklet 0\.l: is None"):
        import_kitti(drive.root, tiny.DRIVE, tmp_path / "log", path, refine=False)
    path.write_text("<a>")
    with pytest.raises(InputError, match="XML: cannot be read"):
        import_kitti(drive.root, tiny.DRIVE, tmp_path / "log", path, refine=False)


def test_a_full_disk_leaves_nothing(
    drive: tiny.TinyDrive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("recast.logs.store.write_map", full)
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(InputError, match="no space left"):
        import_kitti(drive.root, tiny.DRIVE, out / "log", drive.labels, refine=False)
    assert list(out.iterdir()) == []
