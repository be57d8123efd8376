"""Every kind of bad input ends in one line on stderr, exit code 2, and nothing half-written."""

from __future__ import annotations

import dataclasses
import errno
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from recast.cli.main import main
from recast.core import files
from recast.logs import DrivingLog, LidarSweep, Trajectory, read_log, write_log
from recast.reconstruction import SceneConfig, write_config
from support import tiny_drive as tiny

RUN = ("--track", "0", "--motion", "advancing-a", "--threads", "1")


def refused(capsys: pytest.CaptureFixture[str], *args: str | Path) -> str:
    """The one line of a command that must be refused."""
    capsys.readouterr()
    assert main([str(arg) for arg in args]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("recast: ")
    assert ";" in lines[0], "names the mend"
    return lines[0]


def test_an_import_that_fails_leaves_nothing(
    tiny_drive: tiny.TinyDrive, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "kitti"
    shutil.copytree(tiny_drive.root, root)
    (root / tiny.DATE / "calib_velo_to_cam.txt").unlink()
    out = tmp_path / "logs" / "log"
    line = refused(capsys, "log", "import", "kitti", root, "--drive", tiny.DRIVE, "--out", out)
    assert "calib_velo_to_cam.txt" in line
    assert not out.exists()
    assert not list(tmp_path.rglob("*partial*"))


def test_a_track_that_is_not_there(
    tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    line = refused(capsys, "run", tiny_log_folder, "--track", "99", "--out", out)
    assert "track 99" in line
    assert "choose one of 0, 1" in line
    assert not out.exists()


def altered(log: DrivingLog, folder: Path, **changes: object) -> Path:
    write_log(dataclasses.replace(log, **changes), folder)  # type: ignore[arg-type]
    return folder


def test_a_track_that_is_never_visible(
    tiny_log: DrivingLog, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    track = tiny_log.tracks["0"]
    poses = track.trajectory.poses.copy()
    ego = tiny_log.world_from_rig.poses[0]
    poses[:, :3, 3] -= 40 * ego[:3, 0]  # far behind the only camera, which looks ahead
    behind = dataclasses.replace(
        track, trajectory=Trajectory(track.trajectory.timestamps_us, poses)
    )
    log = altered(tiny_log, tmp_path / "log", tracks={**tiny_log.tracks, "0": behind})
    line = refused(capsys, "actor", "make", log, "--track", "0", "--out", tmp_path / "actor")
    assert "track 0" in line
    assert not (tmp_path / "actor").exists()


class Empty:
    """Sweeps without points."""

    def __init__(self, times: np.ndarray) -> None:
        self.times = times

    def __len__(self) -> int:
        return len(self.times)

    def __getitem__(self, index: int, /) -> LidarSweep:
        return LidarSweep(
            int(self.times[index]), np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
        )


def test_a_track_with_too_few_lidar_points(
    tiny_log: DrivingLog, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lidars = {
        name: dataclasses.replace(stream, sweeps=Empty(stream.timestamps_us))
        for name, stream in tiny_log.lidars.items()
    }
    log = altered(tiny_log, tmp_path / "log", lidars=lidars)
    line = refused(capsys, "actor", "make", log, "--track", "0", "--out", tmp_path / "actor")
    assert "0 LiDAR points" in line
    assert "20" in line
    assert not (tmp_path / "actor").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 1\n"
            b"property float x\nend_header\n\0\0\0\0",
            "bad.ply",
        ),
        (b"no ply at all", "bad.ply"),
    ],
)
def test_a_ply_that_is_none(
    tiny_log_folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    text: bytes,
    message: str,
) -> None:
    ply = tmp_path / "bad.ply"
    ply.write_bytes(text)
    line = refused(
        capsys,
        "actor",
        "make",
        tiny_log_folder,
        "--track",
        "0",
        "--generator",
        ply,
        "--out",
        tmp_path / "actor",
    )
    assert message in line
    assert not (tmp_path / "actor").exists()


def test_a_folder_that_holds_something_else(
    tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "thesis.tex").write_text("years of work")
    line = refused(capsys, "run", tiny_log_folder, *RUN, "--out", tmp_path / "run")
    assert "run.json" in line
    assert [p.name for p in (tmp_path / "run").iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize("name", ["--config", "--scene-config"])
def test_a_configuration_of_another_version(
    tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    path = tmp_path / "config.json"
    path.write_text(json.dumps({"version": 99, "track": "0", "motions": ["cut-in-a"]}))
    out = tmp_path / "run"
    line = refused(capsys, "run", tiny_log_folder, *RUN, "--out", out, name, path)
    assert "version" in line
    assert "99" in line
    assert not out.exists()


def test_a_value_out_of_range(
    tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refused(capsys, "run", tiny_log_folder, *RUN, "--out", tmp_path / "r", "--scale", "7")
    assert "scale" in line


def test_a_planner_or_generator_or_segmenter_or_motion_that_is_not_known(
    tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for option in ("--planner", "--generator", "--segmenter", "--motion"):
        out = tmp_path / "run"
        line = refused(capsys, "run", tiny_log_folder, *RUN, "--out", out, option, "nonesuch")
        assert "nonesuch" in line
        assert not out.exists()


def test_a_segmenter_folder_without_its_networks(
    tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    networks = tmp_path / "networks"
    (networks / "sam").mkdir(parents=True)
    for command in (("run", *RUN), ("actor", "make", "--track", "0")):
        out = tmp_path / "out"
        line = refused(capsys, *command, tiny_log_folder, "--segmenter", networks, "--out", out)
        assert "networks/grounding-dino: config.json: is missing" in line
        assert "IDEA-Research/grounding-dino-base" in line
        assert not out.exists()


def test_a_full_disk(
    tiny_drive: tiny.TinyDrive,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files, "write_bytes", full)
    line = refused(
        capsys,
        "log",
        "import",
        "kitti",
        tiny_drive.root,
        "--drive",
        tiny.DRIVE,
        "--labels",
        tiny_drive.labels,
        "--out",
        tmp_path / "log",
    )
    assert "no space left" in line
    assert list(tmp_path.iterdir()) == []


def test_something_that_is_no_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refused(capsys, "log", "info", tmp_path / "nowhere")
    refused(capsys, "report", tmp_path / "nowhere")
    refused(capsys, "scene", "eval", tmp_path / "nowhere", "--log", tmp_path / "nowhere")


def test_the_tiny_log_reads_back(tiny_log_folder: Path) -> None:
    assert main(["log", "info", str(tiny_log_folder)]) == 0
    assert read_log(tiny_log_folder).tracks


def test_a_preset_that_a_whole_configuration_leaves_nothing_to_set(
    tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_config(SceneConfig(), tmp_path / "scene.json")
    out = tmp_path / "run"
    scene = ("--preset", "omnire", "--scene-config", tmp_path / "scene.json")
    line = refused(capsys, "run", tiny_log_folder, *RUN, *scene, "--out", out)
    assert "--preset: omnire: changes nothing" in line
    assert not out.exists()
