"""Names of tracks and sensors from outside come back as they were, and never become a path."""

from __future__ import annotations

import io
import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from ncore.data.v4 import SequenceComponentGroupsReader, SequenceLoaderV4
from rich.console import Console

from recast.cli.rows.logs import log_info_tables
from recast.core.errors import InputError
from recast.core.files import folder_name
from recast.logs import DrivingLog, Track, Trajectory, log_info, read_log, write_log
from support.importing import import_drive
from support.small_log import small_log
from support.tiny_drive import DRIVE, TinyDrive

HOSTILE = [
    "../x",
    "../../../../victim",
    "/etc/passwd",
    "a/b",
    "..",
    ".",
    ".hidden",
    "-rf",
    "a\0b",
    "a\nb",
    "\r",
    " ",
    "a b",
    "x" * 300,
    "\u202egnp.x",
    "<script>alert(1)</script>",
    "[red]x[/red]",
    "C:\\x",
    "con",
    "{track}",
    "%s",
    "ä",
    "车辆",
    "🚗",
    "default",
    "cameras",
    ".zarray",
    "a'b\"c",
]


def _named(name: str) -> DrivingLog:
    """The small log with this name wherever a name can be, beside plain ones."""
    log = small_log(np.random.default_rng(7))
    camera, lidar, track = log.cameras["front"], log.lidars["top"], log.tracks["car 7"]
    other = f"{name}2"
    return replace(
        log,
        name=name,
        cameras={name: replace(camera, name=name), "front": camera},
        lidars={other: replace(lidar, name=other), "top": lidar},
        tracks={name: replace(track, track_id=name, category=name), "car 7": track},
        metadata={name: name},
    )


@pytest.mark.parametrize("name", HOSTILE, ids=ascii)
def test_a_log_keeps_any_name_and_stays_in_its_folder(name: str, tmp_path: Path) -> None:
    log = _named(name)
    write_log(log, tmp_path / "deep" / "log")
    assert [path.name for path in tmp_path.iterdir()] == ["deep"]
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["log"]
    assert all(path.is_file() for path in (tmp_path / "deep" / "log").iterdir())
    back = read_log(tmp_path / "deep" / "log")
    assert (back.name, back.metadata) == (name, {name: name})
    assert [*back.cameras] == [name, "front"]
    assert [*back.lidars] == [f"{name}2", "top"]
    assert [*back.tracks] == [name, "car 7"]
    assert back.tracks[name].category == name
    np.testing.assert_array_equal(back.cameras[name].images[1], log.cameras[name].images[1])
    np.testing.assert_allclose(
        back.lidars[f"{name}2"].sweeps[1].points, log.lidars["top"].sweeps[1].points, atol=1e-4
    )
    info = log_info(back)
    assert name in {track["track_id"] for track in json.loads(json.dumps(asdict(info)))["tracks"]}


@pytest.mark.parametrize("width", [20, 80, 400])
def test_the_tables_hold_names_whole_and_no_control_characters(width: int) -> None:
    log = small_log(np.random.default_rng(7))
    one = log.tracks["car 7"]
    tracks = {name: replace(one, track_id=name) for name in HOSTILE}
    info = log_info(replace(log, tracks=tracks))
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(*log_info_tables(info, width), sep="\n")
    text = console.export_text()
    assert all(len(line) <= width for line in text.splitlines())
    assert not {"\0", "\r", "\u202e"} & set(text)
    joined = "".join(text.split())
    for name in HOSTILE:
        if name.isascii() and name.isprintable():
            assert "".join(name.split()) in joined
    assert "a\\nb" in joined and "\\u202egnp.x" in joined and "a\\x00b" in joined


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("", "a name must have 1 to 1000"),
        ("x" * 1001, "a name must have 1 to 1000"),
        ("\ud800", "surrogate"),
    ],
    ids=ascii,
)
def test_names_that_a_store_cannot_hold_are_refused_at_once(
    name: str, message: str, tmp_path: Path
) -> None:
    log = small_log(np.random.default_rng(7))
    times = log.world_from_rig.timestamps_us[:1]
    track = Track(name, "car", np.ones(3), Trajectory(times, np.eye(4)[None]))
    camera = replace(log.cameras["front"], name=name)
    for change in ({"tracks": {name: track}}, {"cameras": {name: camera}}):
        with pytest.raises(InputError, match=message) as error:
            write_log(replace(log, **change), tmp_path / "log")  # type: ignore[arg-type]
        assert len(str(error.value)) <= 300 and str(error.value).isprintable()
    assert list(tmp_path.iterdir()) == []


def test_ncore_reads_sensors_of_any_name(tmp_path: Path) -> None:
    write_log(_named("../x"), tmp_path / "log")
    loader = SequenceLoaderV4(SequenceComponentGroupsReader([tmp_path / "log" / "ncore.json"]))
    stored = folder_name("../x")
    assert sorted(loader.camera_ids) == ["front", stored]
    assert loader.get_camera_sensor(stored).frames_count == 3


@pytest.mark.parametrize("name", [*HOSTILE, ""], ids=ascii)
def test_an_import_looks_for_cameras_in_the_drive_only(
    name: str, tiny_drive: TinyDrive, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="choose one of image_02") as error:
        import_drive("kitti", tiny_drive.root, DRIVE, tmp_path / "log", cameras=[name])
    assert str(error.value).isprintable()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", HOSTILE, ids=ascii)
def test_an_import_finds_only_drives_of_their_names(
    name: str, tiny_drive: TinyDrive, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="does not exist") as error:
        import_drive("kitti", tiny_drive.root, name, tmp_path / "log")
    assert str(error.value).isprintable()
