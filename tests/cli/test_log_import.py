"""`recast log import`: which cameras, and options that an importer does not know."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from recast.cli.main import main
from recast.logs import DrivingLog, read_log
from recast.logs.importers import IMPORTERS
from support.small_log import small_log
from support.tiny_argoverse2 import LOG
from support.tiny_argoverse2 import write_tiny_log as write_tiny_argoverse2
from support.tiny_drive import DRIVE, TinyDrive
from support.tiny_nuscenes import SCENE, write_tiny_nuscenes


@pytest.fixture
def drive(tiny_drive: TinyDrive, tmp_path: Path) -> TinyDrive:
    """The drive with a second coloured camera and a grey one, of the same pictures."""
    shutil.copytree(tiny_drive.root, tmp_path / "kitti")
    drive = TinyDrive(tmp_path / "kitti", tmp_path / "kitti" / "labels.txt")
    for name in ("image_00", "image_03"):
        shutil.copytree(drive.folder / "image_02", drive.folder / name)
    calibration = drive.folder.parent / "calib_cam_to_cam.txt"
    text = calibration.read_text()
    second = [line for line in text.splitlines() if "_rect_02" in line]
    calibration.write_text(text + "\n".join(second).replace("_02", "_03") + "\n")
    return drive


def _imported(drive: TinyDrive, out: Path, *options: str) -> int:
    words = ["kitti", drive.root, "--drive", DRIVE, "--labels", drive.labels, "--out", out]
    return main(["log", "import", *map(str, words), *options])


def test_cameras_are_chosen_by_name_and_coloured_ones_by_default(
    drive: TinyDrive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("recast.logs.importers.kitti.ego_path", lambda _: None)
    for number, (options, cameras, poses) in enumerate(
        [
            (["--no-refine"], ["image_02", "image_03"], "OXTS"),
            (
                ["--no-refine", "--cameras", "image_03", "image_00"],
                ["image_00", "image_03"],
                "OXTS",
            ),
            (["--cameras", "image_02"], ["image_02"], "OXTS refined by LiDAR"),
        ]
    ):
        assert _imported(drive, tmp_path / str(number), *options) == 0
        log = read_log(tmp_path / str(number))
        assert [*log.cameras] == cameras
        assert log.metadata["poses"] == poses


def test_grey_cameras_are_taken_where_there_are_no_others(
    drive: TinyDrive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("recast.logs.importers.kitti.ego_path", lambda _: None)
    for name in ("image_02", "image_03"):
        shutil.rmtree(drive.folder / name)
    assert _imported(drive, tmp_path / "log", "--no-refine") == 0
    assert [*read_log(tmp_path / "log").cameras] == ["image_00"]


def test_unknown_cameras_are_refused_with_those_there_are(
    drive: TinyDrive, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _imported(drive, tmp_path / "log", "--cameras", "image_02", "front") == 2
    line = capsys.readouterr().err
    assert "'front'; choose one of image_00, image_02, image_03" in " ".join(line.split())
    assert line.count("\n") == 1
    assert not (tmp_path / "log").exists()


def own_importer(root: Path, drive: str) -> DrivingLog:
    """An importer of another package, without any options."""
    return small_log(np.random.default_rng(7))


def silent_importer(root: Path, drive: str, labels: Path | None = None) -> None:
    """One that returns nothing."""


def raising_importer(root: Path, drive: str) -> DrivingLog:
    """An importer whose images cannot be read."""
    return own_importer(root / {}["poses"], drive)  # type: ignore[index]


def lacking_importer(root: Path, drive: str) -> DrivingLog:
    """An importer whose file is not there."""
    (root / "poses.txt").read_text()
    return own_importer(root, drive)


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("raising_importer", "raises KeyError: 'poses', test_log_import.py line "),
        ("lacking_importer", "raises FileNotFoundError: [Errno 2]"),
    ],
)
def test_what_an_importer_raises_is_one_line(
    name: str, problem: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run_own(name, tmp_path / "log") == 2
    line = _line(capsys)
    assert line.startswith(f"recast: importer {__name__}:{name}: ") and problem in line
    assert list(tmp_path.iterdir()) == []
    assert _run_own(name, tmp_path / "log", "--verbose") == 2
    assert "Traceback" in capsys.readouterr().err


def test_options_that_an_importer_does_not_know_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for *options, name in (
        ("--cameras", "front", "cameras"),
        ("--no-refine", "refine"),
        ("--labels", "x", "labels"),
    ):
        assert _run_own("own_importer", tmp_path / "log", *options) == 2
        assert f"own_importer: has no option {name}; leave it out" in _line(capsys)
    assert not (tmp_path / "log").exists()
    assert _run_own("own_importer", tmp_path / "log") == 0
    assert read_log(tmp_path / "log").name == small_log(np.random.default_rng(7)).name


def test_importers_that_return_no_log_are_told_what_to_change(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run_own("silent_importer", tmp_path / "log") == 2
    assert "returned NoneType in place of a DrivingLog; return the log" in _line(capsys)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_output_folder_is_refused_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "log").mkdir()
    assert _run_own("silent_importer", tmp_path / "log") == 2
    assert "output folder: exists already" in _line(capsys)


def _run_own(name: str, out: Path, *options: str) -> int:
    words = [f"{__name__}:{name}", out.parent, "--drive", "x", "--out", out]
    return main(["log", "import", *map(str, words), *options])


def _line(capsys: pytest.CaptureFixture[str]) -> str:
    [line] = capsys.readouterr().err.splitlines()
    return line


def test_experimental_importers_say_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "1000")
    with pytest.raises(SystemExit):
        main(["log", "import", "--help"])
    tried, _, untried = " ".join(capsys.readouterr().out.split()).partition("experimental,")
    untried = untried.partition("or an installed importer")[0]
    assert set(re.findall(r"[a-z0-9]+(?:-[a-z0-9]+)?", untried)) >= IMPORTERS.experimental
    assert not any(f" {name} (" in tried for name in IMPORTERS.experimental)
    write_tiny_nuscenes(tmp_path / "data")
    out = tmp_path / "log"
    words = ["log", "import", "nuscenes", tmp_path / "data", "--drive", SCENE, "--out", out]
    assert main([*map(str, words)]) == 0
    assert "note: nuscenes is experimental" in capsys.readouterr().out


def test_a_camera_without_images_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_tiny_argoverse2(tmp_path / "av2")
    for path in (folder / "sensors/cameras/ring_front_center").glob("*"):
        path.rename(path.with_suffix(".webp"))
    words = ["argoverse2", tmp_path / "av2", "--drive", LOG, "--out", tmp_path / "log"]
    assert main(["log", "import", *map(str, words)]) == 0
    imported = capsys.readouterr().out
    assert main(["log", "info", str(tmp_path / "log")]) == 0
    for text in (imported, capsys.readouterr().out):
        assert "no images of ring_front_center" in " ".join(text.split())
