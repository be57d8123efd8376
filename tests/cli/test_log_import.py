"""`recast log import`: which cameras, and options that an importer does not know."""

from __future__ import annotations

import inspect
import shutil
from pathlib import Path

import pytest

from recast.cli.main import main
from recast.logs import read_log
from recast.logs.importers import IMPORTERS
from support.tiny_drive import DRIVE, TinyDrive


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
    assert "'front'; choose from image_00, image_02, image_03" in " ".join(line.split())
    assert line.count("\n") == 1
    assert not (tmp_path / "log").exists()


def old_importer(root: Path, drive: str, out: Path, labels: Path | None = None) -> None:
    """An importer of another package, from before there were cameras."""
    out.mkdir()


def test_options_that_an_importer_does_not_know_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(*options: str) -> int:
        name = f"{old_importer.__module__}:old_importer"
        words = [name, tmp_path, "--drive", "x", "--out", tmp_path / "log"]
        return main(["log", "import", *map(str, words), *options])

    assert run("--cameras", "front") == 2
    assert "--cameras: " in capsys.readouterr().err
    assert run("--no-refine") == 2
    assert "--no-refine: " in capsys.readouterr().err
    assert not (tmp_path / "log").exists()
    assert run() == 0
    assert (tmp_path / "log").is_dir()


def test_every_importer_takes_cameras() -> None:
    for name in IMPORTERS.built_in:
        parameter = inspect.signature(IMPORTERS.load(name)).parameters["cameras"]
        assert parameter.default == (), name
