"""`recast log info`: ids whole at any width, best candidates first and why, JSON for programs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from recast.cli.main import main
from recast.logs import DrivingLog, TrackInfo, TrackVisibility, write_log
from recast.logs.load import FEWEST_POINTS, ranked

UUID = "b87c7491-db0b-49e1-9fb8-ecc52f13184e"


def _printed(
    folder: Path, width: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    monkeypatch.setenv("COLUMNS", str(width))
    capsys.readouterr()
    assert main(["log", "info", str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(len(line) <= width for line in lines)
    assert "…" not in "".join(lines)
    return lines


def test_everything_fits_80_columns_where_ids_are_short(
    tiny_log_folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = _printed(tiny_log_folder, 80, capsys, monkeypatch)
    heading = next(line for line in lines if line.startswith("track "))
    columns = [
        "track",
        "class",
        "s",
        "moves",
        "LiDAR",
        "seen",
        "px",
        "front",
        "left",
        "rear",
        "right",
    ]
    assert heading.split() == columns
    rows = lines[lines.index(heading) + 2 :]
    assert [row.split()[0] for row in rows] == ["0", "1"]  # the nearer for longer comes first
    assert rows[0].split()[1:2] == ["car"] and rows[0].split()[-4:-2] == ["-", "-"]
    note = " ".join(lines)
    assert "no room for l w h m: see --json" in " ".join(note.split())
    wide = _printed(tiny_log_folder, 100, capsys, monkeypatch)
    assert "no room" not in " ".join(wide)
    assert any("l w h m" in line for line in wide)


@pytest.mark.parametrize("width", [80, 60, 40])
def test_long_ids_stay_whole(
    width: int,
    tiny_log: DrivingLog,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tracks = {UUID: replace(tiny_log.tracks["0"], track_id=UUID), "1": tiny_log.tracks["1"]}
    write_log(replace(tiny_log, tracks=tracks), tmp_path / "log")
    lines = _printed(tmp_path / "log", width, capsys, monkeypatch)
    rows = [line for line in lines if line.startswith(UUID)]
    assert len(rows) == 1
    assert any(line.startswith(f" {UUID}") for line in lines), "among the best candidates"
    assert (len(rows[0].split()) > 1) == (width > 42)  # where the column "seen" has room


def test_candidates_are_told_with_why(
    tiny_log_folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = _printed(tiny_log_folder, 200, capsys, monkeypatch)
    best = lines[lines.index("best candidates for replacing:") + 1]
    assert best.split()[:4] == ["0", "moves;", "24", "frames,"]
    assert "LiDAR points; front, left never seen; views span " in best


def test_json_holds_everything(tiny_log_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["log", "info", str(tiny_log_folder), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    [log] = [row for row in rows if row["table"] == "log"]
    assert log["map_kind"] == "derived" and log["duration_s"] > 1
    first, second = (row for row in rows if row["table"] == "tracks")
    assert (first["track_id"], first["usable"]) == ("0", True)
    assert first["frames"] == 24 and first["crop_width_px"] > 10
    [camera] = [row for row in rows if row["table"] == "sensors" and row["kind"] == "camera"]
    assert camera["rate_hz"] > 1 and camera["width_px"] > 10
    assert second["track_id"] == "1" and "stands; " in second["why"]


def _track(name: str, category: str = "car", points: int = 100, frames: int = 10) -> TrackInfo:
    visibility = TrackVisibility(frames, 0, 0, frames, 0, (40, 30) if frames else (0, 0))
    return TrackInfo(name, category, (4.0, 2.0, 1.5), 1.0, 0.0, points, visibility)


def test_what_can_be_replaced_comes_before_what_cannot() -> None:
    tracks = [
        _track("walker", "pedestrian", 10**6, 500),
        _track("trailer", "trailer", 10**6, 500),
        _track("unseen", points=10**6, frames=0),
        _track("far", points=FEWEST_POINTS - 1, frames=500),
        _track("just", points=FEWEST_POINTS, frames=1),
        _track("good", "van", points=10**4, frames=20),
    ]
    found = ranked(tracks)
    order = ["good", "just", "walker", "far", "unseen", "trailer"]
    assert [track.track_id for track in found] == order
    assert [track.usable for track in found] == [True, True, True, False, False, False]
    assert [track.why.split(";")[0] for track in found[3:]] == [
        f"has {FEWEST_POINTS - 1} LiDAR points, {FEWEST_POINTS} are needed",
        "is not visible in any image",
        "is not a car, van, truck, bus, pedestrian or cyclist",
    ]


def test_what_was_measured_and_what_is_odd_is_printed(
    tiny_log: DrivingLog,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tracks = {name: replace(one, size=one.size[[1, 0, 2]]) for name, one in tiny_log.tracks.items()}
    write_log(replace(tiny_log, tracks=tracks), tmp_path / "log")
    text = " ".join(_printed(tmp_path / "log", 80, capsys, monkeypatch))
    text = " ".join(text.split())
    assert "measured: rig leans 0.0°, faces 0.0° off its motion" in text
    assert "warning: tracks: 2 of 2 tracks are wider or higher than they are long" in text
    assert main(["log", "info", str(tmp_path / "log"), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    measured = [row for row in rows if row["table"] == "plausibility"]
    assert [row["wider_than_long"] for row in measured] == [2]
    assert any("are sizes length" in row["warning"] for row in rows if row["table"] == "warnings")
