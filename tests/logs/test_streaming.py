"""Imports hold a frame at a time, tell how far they are, and leave nothing when they are ended."""

from __future__ import annotations

import os
import signal
import sys
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from recast.cameras import PinholeCamera
from recast.cli.main import main
from recast.logs import (
    CameraStream,
    DrivingLog,
    LidarStream,
    LidarSweep,
    Trajectory,
    read_log,
    write_log,
)
from support import tiny_argoverse2 as tiny
from support.importing import import_drive

FRAMES, IMAGE_BYTES, POINTS = 20, 300_000, 5_000
ALL_BYTES = FRAMES * (IMAGE_BYTES + 12 * POINTS)


class Noise:
    """Images that are as large as real ones, made when asked for."""

    def __len__(self) -> int:
        return FRAMES

    def __getitem__(self, index: int) -> np.ndarray:
        raise AssertionError("encoded images are not decoded")

    def encoded(self, index: int) -> tuple[bytes, str]:
        return np.random.default_rng(index).bytes(IMAGE_BYTES), "jpeg"


class NoisySweeps:
    """Sweeps made when asked for, every point with its own time."""

    def __init__(self, times: np.ndarray) -> None:
        self._times = times

    def __len__(self) -> int:
        return FRAMES

    def __getitem__(self, index: int) -> LidarSweep:
        rng, time = np.random.default_rng(index), int(self._times[index])
        return LidarSweep(
            time,
            rng.normal(0, 20, (POINTS, 3)).astype(np.float32),
            rng.random(POINTS).astype(np.float32),
            time + rng.integers(0, 90_000, POINTS),
        )


@pytest.fixture
def large() -> DrivingLog:
    times = 100_000 * np.arange(FRAMES + 1, dtype=np.int64)
    poses = np.tile(np.eye(4), (FRAMES + 1, 1, 1))
    poses[:, 0, 3] = np.arange(FRAMES + 1)
    camera = PinholeCamera(640, 480, 500.0, 500.0, 320.0, 240.0)
    return DrivingLog(
        name="large",
        cameras={"front": CameraStream("front", camera, np.eye(4), times[:-1], Noise())},
        lidars={"top": LidarStream("top", np.eye(4), times[:-1], NoisySweeps(times))},
        world_from_rig=Trajectory(times, poses),
        tracks={},
    )


def test_a_frame_at_a_time_is_in_memory_and_progress_is_told(
    large: DrivingLog, tmp_path: Path
) -> None:
    told: list[tuple[int, int]] = []
    peaks: list[int] = []

    def watch(done: int, total: int) -> None:
        told.append((done, total))
        peaks.append(tracemalloc.get_traced_memory()[1])

    tracemalloc.start()
    try:
        write_log(large, tmp_path / "log", watch)
        log = read_log(tmp_path / "log")
        opened = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()  # opening unpacks the tables of contents
        for index in range(FRAMES):
            assert len(log.cameras["front"].images.encoded(index)[0]) == IMAGE_BYTES
            assert len(log.lidars["top"].sweeps[index].points) == POINTS
        read_peak = tracemalloc.get_traced_memory()[1] - opened
    finally:
        tracemalloc.stop()
    assert told == [(done, 2 * FRAMES) for done in range(2 * FRAMES + 1)]
    assert sum(path.stat().st_size for path in (tmp_path / "log").iterdir()) > ALL_BYTES
    # Closing the stores takes 0.1 GB for packing their tables of contents, whatever their length.
    assert max(peaks) < ALL_BYTES / 2
    assert read_peak < ALL_BYTES / 2


def _import_stuck_at_an_image(root: Path, out: Path, end: signal.Signals) -> int:
    """Import the tiny log in a process of its own, end it in the middle; returns its status."""
    image = sorted(root.glob(f"val/{tiny.LOG}/sensors/cameras/ring_side_left/*.jpg"))[4]
    data = image.read_bytes()
    image.unlink()
    os.mkfifo(image)  # reading it waits until somebody writes
    child = os.fork()
    if child == 0:
        code = 1
        try:
            # A shell starts background jobs with the interrupt ignored, and the tests may be one.
            signal.signal(signal.SIGINT, signal.default_int_handler)
            code = main(
                ["log", "import", "argoverse2", str(root), "--drive", tiny.LOG, "--out", str(out)]
            )
        finally:
            os._exit(code)
    deadline = time.monotonic() + 120
    while True:
        try:
            pipe = os.open(image, os.O_WRONLY | os.O_NONBLOCK)  # fails until the child reads
            break
        except OSError:
            assert time.monotonic() < deadline and os.waitpid(child, os.WNOHANG)[0] == 0
            time.sleep(0.01)
    assert list(out.parent.glob(".*")) != []  # half a log is there, under another name
    os.kill(child, end)
    status = os.waitpid(child, 0)[1]
    os.close(pipe)
    image.unlink()
    image.write_bytes(data)
    assert not out.exists()
    return os.waitstatus_to_exitcode(status)


def _tree(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.skipif(sys.platform == "win32", reason="no fork")
def test_an_ended_import_leaves_nothing_that_the_next_one_does_not_clear(tmp_path: Path) -> None:
    root, out = tmp_path / "root", tmp_path / "out" / "log"
    tiny.write_tiny_log(root)
    import_drive("argoverse2", root, tiny.LOG, tmp_path / "whole")
    assert _import_stuck_at_an_image(root, out, signal.SIGINT) == 130
    assert list(out.parent.iterdir()) == []
    assert _import_stuck_at_an_image(root, out, signal.SIGKILL) == -signal.SIGKILL
    assert [path.name for path in out.parent.iterdir()] == [".log.partial"]
    import_drive("argoverse2", root, tiny.LOG, out)
    assert [path.name for path in out.parent.iterdir()] == ["log"]
    assert _tree(out) == _tree(tmp_path / "whole")


def test_the_command_shows_images_and_sweeps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny.write_tiny_log(tmp_path)
    out = tmp_path / "log"
    assert (
        main(["log", "import", "argoverse2", str(tmp_path), "--drive", tiny.LOG, "--out", str(out)])
        == 0
    )
    # 9 images of each of two cameras, 2 sweeps of each of two LiDARs.
    assert "22/22" in capsys.readouterr().out
