"""`load_log`: folders, logs and datasets; and where a log comes from."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.logs import DrivingLog, load_log, read_log, write_log
from support import tiny_argoverse2 as tiny
from support.small_log import small_log
from support.tiny_drive import DRIVE, TinyDrive


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_log(small_log(np.random.default_rng(7)), tmp_path / "log")
    return tmp_path / "log"


def test_the_origin_is_the_folder_of_a_log_as_it_was_read(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert small_log(np.random.default_rng(7)).origin is None
    monkeypatch.chdir(tmp_path)
    log = read_log("log")
    assert log.origin == folder and log.origin.is_absolute()
    assert pickle.loads(pickle.dumps(log)).origin == folder
    assert replace(log, tracks={}).origin is None, "another log than that of the folder"
    with pytest.raises(ValueError, match="origin"):
        replace(log, origin=folder)
    for name, one in (("a", log), ("b", replace(log))):
        write_log(one, tmp_path / name)
    for path in (tmp_path / "a").iterdir():
        assert (tmp_path / "b" / path.name).read_bytes() == path.read_bytes()


def test_a_folder_or_a_log(folder: Path) -> None:
    log = load_log(folder)
    assert log.origin == load_log(str(folder)).origin == folder
    assert load_log(log) is log
    with pytest.raises(InputError, match="does not exist"):
        load_log(folder / "none")


def test_a_drive_of_a_dataset_is_not_written(tmp_path: Path) -> None:
    tiny.write_tiny_log(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    log = load_log(tmp_path, importer="argoverse2", drive=tiny.LOG, cameras=["ring_side_left"])
    assert list(log.cameras) == ["ring_side_left"] and log.origin is None
    assert sorted(tmp_path.rglob("*")) == before
    images = log.cameras["ring_side_left"].images
    next(tmp_path.glob(f"val/{tiny.LOG}/sensors/cameras/ring_side_left/*.jpg")).write_bytes(b"")
    with pytest.raises(InputError):  # decoded only now
        [images[i] for i in range(len(images))]


def test_options_of_the_importer_are_passed_on(tiny_drive: TinyDrive) -> None:
    options: dict[str, Any] = {"labels": str(tiny_drive.labels), "refine": False, "with_map": False}
    log = load_log(str(tiny_drive.root), importer="kitti", drive=DRIVE, **options)
    assert log.metadata["poses"] == "OXTS" and log.tracks and log.map is None


def own(root: Path, drive: str, **options: Any) -> DrivingLog:
    """An importer of the user's."""
    log = small_log(np.random.default_rng(7))
    return replace(log, name=drive, metadata={key: str(value) for key, value in options.items()})


def invalid(root: Path, drive: str) -> DrivingLog:
    """An importer whose log has a name that cannot be stored."""
    return replace(small_log(np.random.default_rng(7)), name="\ud800")


@pytest.mark.parametrize("importer", [own, f"{__name__}:own"])
def test_an_importer_of_the_user(importer: Any) -> None:
    log = load_log("data", importer=importer, drive="x", cameras=["a"], speed=3)
    assert log.name == "x" and log.metadata == {"cameras": "('a',)", "speed": "3"}


@pytest.mark.parametrize(
    ("source", "options", "message"),
    [
        ("data", {"drive": "x"}, "load_log: importer: is missing"),
        ("data", {"refine": False}, "load_log: importer: is missing"),
        ("data", {"importer": own}, "importer: own: needs the name of a drive"),
        ("s3://data", {"importer": own, "drive": "x"}, "cannot read s3://data; name a local f"),
        (3, {"importer": own, "drive": "x"}, "source: is 3; give a path"),
        ("data", {"importer": "kiti", "drive": "x"}, "kiti: is not known; did you mean kitti"),
        ("data", {"importer": 3, "drive": "x"}, "importer: 3: is not known"),
        (
            "data",
            {"importer": invalid, "drive": "x"},
            "name: .* contains a lone surrogate character",
        ),
    ],
)
def test_what_cannot_be_meant_is_one_line(
    source: Any, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message) as error:
        load_log(source, **options)
    assert "\n" not in str(error.value)
