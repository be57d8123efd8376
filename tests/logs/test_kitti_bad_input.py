"""Bad KITTI input: one line that names the file, the field and the mend, and nothing written."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.logs.importers.kitti import load_kitti
from support import tiny_drive as tiny
from support.importing import import_drive

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


def _set(path: Path, name: str, index: int, value: str) -> None:
    """Write another number at `index` of a field of a calibration file."""
    lines = path.read_text().splitlines()
    row = next(i for i, line in enumerate(lines) if line.startswith(f"{name}:"))
    words = lines[row].split()
    words[1 + index] = value
    lines[row] = " ".join(words)
    path.write_text("\n".join(lines) + "\n")


def _camera(field: str, index: int, value: str) -> Damage:
    return lambda d: _set(_calibration(d, "calib_cam_to_cam.txt"), field, index, value)


def _latin(path: Path) -> None:
    path.write_bytes(path.read_bytes() + b"\xe9t\xe9\n")


def _time(value: str) -> Damage:
    def change(drive: tiny.TinyDrive) -> None:
        path = drive.folder / "velodyne_points/timestamps.txt"
        lines = path.read_text().splitlines()
        path.write_text("\n".join([*lines[:4], value, *lines[5:]]) + "\n")

    return change


def _label(column: int, value: str) -> Damage:
    def change(drive: tiny.TinyDrive) -> None:
        rows = [line.split(" ") for line in drive.labels.read_text().splitlines()]
        rows[0][column] = value
        drive.labels.write_text("\n".join(" ".join(row) for row in rows) + "\n")

    return change


def _sweep(column: int, value: float) -> Damage:
    def change(drive: tiny.TinyDrive) -> None:
        path = drive.folder / "velodyne_points/data/0000000004.bin"
        points = np.fromfile(path, np.float32).reshape(-1, 4)
        points[5, column] = value
        points.tofile(path)

    return change


def _oxts(column: int, value: float) -> Damage:
    def change(drive: tiny.TinyDrive) -> None:
        path = drive.folder / "oxts/data/0000000003.txt"
        words = path.read_text().split()
        words[column] = str(value)
        path.write_text(" ".join(words))

    return change


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
        "calib_imu_to_velo.txt: T: expected 3 numbers, got 2",
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
        "image size: is 160x48, but calib_cam_to_cam.txt says 170x48",
    ),
    "labels of another drive": (
        lambda d: _move_boxes(d.labels, 4.0),
        "labels.txt: boxes: ",
    ),
    "labels of a longer drive": (
        lambda d: _replace(d.labels, "\n23 0 Car", "\n230 0 Car"),
        "labels.txt: track 0: has frame 230, but the drive has 30 frames",
    ),
    "labels with too few columns": (
        lambda d: d.labels.write_text("0 0 Car 0 0\n"),
        "labels.txt: line 1: has 5 columns, 17 are needed",
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
        "0000000003.txt: fields: there are 3 of 30 numbers",
    ),
    "oxts that are not numbers": (
        lambda d: (d.folder / "oxts/data/0000000003.txt").write_text("<html>"),
        "0000000003.txt: numbers: cannot be read",
    ),
    "oxts with a long gap": (
        lambda d: [(d.folder / f"oxts/data/{i:010d}.txt").unlink() for i in range(5, 18)],
        "0000000018.txt: packets before it: are missing for 1.4 s",
    ),
    "oxts that are not finite": (_oxts(8, float("nan")), "fields: hold NaN"),
    "oxts beyond the poles": (_oxts(0, 91.0), "91.0 8.43"),
    "oxts beyond the date line": (_oxts(1, 200.0), "is not a position on a road"),
    "oxts below the sea": (_oxts(2, -1e6), "is not a position on a road"),
    "oxts that jump": (_oxts(0, 49.1), "0000000003.txt: position: is 100"),
    "calibration that is not text": (
        lambda d: _latin(_calibration(d, "calib_cam_to_cam.txt")),
        "calib_cam_to_cam.txt: text: is not UTF-8",
    ),
    "timestamps that are not text": (
        lambda d: _latin(d.folder / "oxts/timestamps.txt"),
        "timestamps.txt: text: is not UTF-8",
    ),
    "labels that are not text": (lambda d: _latin(d.labels), "labels.txt: text: is not UTF-8"),
    "oxts that are not text": (
        lambda d: _latin(d.folder / "oxts/data/0000000003.txt"),
        "0000000003.txt: text: is not UTF-8",
    ),
    "singular projection": (_camera("P_rect_02", 0, "0"), "PinholeCamera.fx, fy: must be"),
    "negative focal length": (_camera("P_rect_02", 5, "-110"), "PinholeCamera.fx, fy: must be"),
    "huge focal length": (_camera("P_rect_02", 0, "1e38"), "PinholeCamera.fx, fy: must be"),
    "huge principal point": (_camera("P_rect_02", 2, "1e38"), "PinholeCamera.cx, cy"),
    "skewed projection": (_camera("P_rect_02", 1, "3"), "P_rect_02: is not the projection"),
    "projection of no camera": (_camera("P_rect_02", 10, "0"), "P_rect_02: is not the projection"),
    "projection far away": (_camera("P_rect_02", 11, "1e9"), "is not within 100000 m"),
    "projection not finite": (_camera("P_rect_02", 3, "nan"), "P_rect_02: holds NaN"),
    "no width": (_camera("S_rect_02", 0, "0"), "PinholeCamera.width, height: 0 x 48"),
    "width of half a pixel": (
        _camera("S_rect_02", 0, "160.5"),
        "160.5 x 48.0 is not a size in pixels",
    ),
    "huge width": (_camera("S_rect_02", 0, "1e300"), "PinholeCamera.width, height"),
    "infinite width": (_camera("S_rect_02", 0, "inf"), "S_rect_02: holds NaN or infinity"),
    "no rectification": (_camera("R_rect_00", 0, "-0.9999"), "R_rect_00: is not a rotation"),
    "mirrored mounting": (
        lambda d: [
            _set(_calibration(d, "calib_velo_to_cam.txt"), "R", i, value)
            for i, value in enumerate(["1", "0", "0", "0", "1", "0", "0", "0", "-1"])
        ],
        "calib_velo_to_cam.txt: R: is not a rotation",
    ),
    "mounting without a rotation": (
        lambda d: [_set(_calibration(d, "calib_imu_to_velo.txt"), "R", i, "0") for i in range(9)],
        "calib_imu_to_velo.txt: R: is not a rotation",
    ),
    "mounting far away": (
        lambda d: _set(_calibration(d, "calib_imu_to_velo.txt"), "T", 1, "1e30"),
        "calib_imu_to_velo.txt: T: 1e+30 is not within",
    ),
    "time NaT": (_time("NaT"), "timestamps.txt: line 5: 'NaT' is not a time"),
    "time of a year": (_time("2011"), "line 5: '2011' is not a time"),
    "time of a day": (_time("2011-09-26"), "line 5: '2011-09-26' is not a time"),
    "time that overflows": (_time("9999-09-26 13:02:26"), "is not a time"),
    "time before computers": (_time("1901-09-26 13:02:26"), "is not a time"),
    "time now": (_time("now"), "line 5: 'now' is not a time"),
    "time of hour 25": (_time("2011-09-26 25:02:26.5"), "is not a time"),
    "time missing in between": (
        _time(""),
        "line 5: is empty, but the frame has the file 0000000004.bin",
    ),
    "times of another day": (
        lambda d: (d.folder / "image_02/timestamps.txt").write_text(
            (d.folder / "image_02/timestamps.txt").read_text().replace("09-26", "09-27")
        ),
        "image_02/timestamps.txt: times: are 86400.010 s after the scanner's triggers",
    ),
    "poses of another day": (
        lambda d: (d.folder / "oxts/timestamps.txt").write_text(
            (d.folder / "oxts/timestamps.txt").read_text().replace("09-26", "09-27")
        ),
        "image_02: timestamps.txt: no frame lies within the times of the OXTS poses",
    ),
    "frame of a superscript": (
        lambda d: (d.folder / "image_02/data/0000000003.png").rename(
            d.folder / "image_02/data/²³.png"
        ),
        "²³.png: file name: is not a frame number",
    ),
    "frame of 25 digits": (
        lambda d: (d.folder / "image_02/data/0000000003.png").rename(
            d.folder / f"image_02/data/{'3' * 25}.png"
        ),
        "file name: is not a frame number",
    ),
    "a frame twice": (
        lambda d: shutil.copy(
            d.folder / "image_02/data/0000000003.png", d.folder / "image_02/data/3.png"
        ),
        "is frame 3, and so is ",
    ),
    "image in place of calibration": (
        lambda d: shutil.copy(
            d.folder / "image_02/data/0000000003.png", _calibration(d, "calib_imu_to_velo.txt")
        ),
        "calib_imu_to_velo.txt: text: is not UTF-8",
    ),
    "sweep of huge points": (_sweep(1, 1e30), "points: lie farther than 100000 m"),
    "reflectance of NaN": (_sweep(3, float("nan")), "reflectance: is not within [0, 1]"),
    "reflectance": (_sweep(3, 1e30), "reflectance: is not within [0, 1]"),
    "huge frame": (_label(0, "9" * 30), "line 1: frame 99999"),
    "frame of 5000 digits": (_label(0, "9" * 5000), "labels.txt: line 1: "),
    "negative frame": (_label(0, "-1"), "line 1: frame -1"),
    "label of NaN": (_label(13, "nan"), "line 1: position: nan is not within"),
    "label far away": (_label(13, "1e30"), "line 1: position: 1e+30 is not within"),
    "label without height": (_label(10, "0"), "line 1: a box must have three sides"),
    "label of infinite length": (_label(12, "inf"), "line 1: a box must have three sides"),
    "label of endless turns": (_label(16, "inf"), "line 1: heading: inf is not within"),
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
        import_drive(
            "kitti", drive.root, tiny.DRIVE, out / "log", labels=drive.labels, refine=False
        )
    assert message in str(error.value)
    assert "\n" not in str(error.value)
    assert list(out.iterdir()) == []


def _field(name: str, value: str) -> tuple[str, str]:
    return rf"<{name}>[^<]*</{name}>", f"<{name}>{value}</{name}>"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ((r"<l>[^<]*</l>", ""), "tracklet 0.l: is None"),
        (_field("h", "nan"), "tracklet 0.h: is 'nan'"),
        (_field("w", "-1"), "tracklet 0: a box must have three sides"),
        (_field("w", "1e30"), "tracklet 0: a box must have three sides"),
        (_field("tx", "inf"), "tracklet 0.tx: is 'inf'"),
        (_field("ty", "1e30"), "tracklet 0: position: 1e+30 is not within"),
        (_field("rz", "1e30"), "tracklet 0: heading: 1e+30 is not within"),
        (_field("first_frame", "-1"), "tracklet 0: has 6 poses from frame -1 on"),
        (_field("first_frame", "nan"), "tracklet 0.first_frame: is 'nan'"),
        (_field("first_frame", "0.5"), "tracklet 0: has 6 poses from frame 0.5 on"),
        (_field("first_frame", "1e300"), "tracklet 0: has 6 poses from frame 1e+300 on"),
        (_field("first_frame", "28"), "track 0: has frame 33, but the drive has 30 frames"),
        (_field("objectType", "Dragon"), "unknown type 'Dragon'"),
        ((r"(?s)<poses>.*</poses>", ""), "tracklet 0: has 0 poses"),
        ((r"(?s).*", "<a>"), "XML: cannot be read"),
        ((r"(?s).*", "<a>" * 100_000), "XML: cannot be read"),
        ((r"<boost", '<!DOCTYPE a [<!ENTITY b "c">]><boost'), "XML: defines entities"),
        ((r"UTF-8", "UTF-\ud800"), "text: is not UTF-8"),
    ],
)
def test_broken_tracklets(
    drive: tiny.TinyDrive, tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    path = tmp_path / "tracklet_labels.xml"
    tiny.write_tracklets(path)
    text, count = re.subn(change[0], change[1], path.read_text(), count=1)
    assert count == 1
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(InputError) as error:
        import_drive("kitti", drive.root, tiny.DRIVE, tmp_path / "log", labels=path, refine=False)
    assert message in str(error.value)
    assert not (tmp_path / "log").exists()


def test_a_full_disk_leaves_nothing(
    drive: tiny.TinyDrive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("recast.logs.store.write_map", full)
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(InputError, match="no space left"):
        import_drive(
            "kitti", drive.root, tiny.DRIVE, out / "log", labels=drive.labels, refine=False
        )
    assert list(out.iterdir()) == []


def test_a_sweep_that_is_a_dead_link_is_one_clear_line(drive: tiny.TinyDrive) -> None:
    """A cut-off download: the poses' refinement is the first that reads it."""
    sweep = sorted((drive.folder / "velodyne_points" / "data").iterdir())[0]
    sweep.unlink()
    sweep.symlink_to("elsewhere.bin")
    with pytest.raises(InputError, match=r"0000000000\.bin: file: is missing"):
        load_kitti(drive.root, tiny.DRIVE, drive.labels)
