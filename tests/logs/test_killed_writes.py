"""Logs are written whole or not at all: kills, full and read-only disks at any moment."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.logs import write_log
from support.importing import import_drive
from support.moments import (
    changes_of,
    killed_before,
    said_on_a_full_disk,
    said_on_a_read_only_disk,
)
from support.small_log import small_log
from support.tiny_drive import DRIVE, TinyDrive

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="moments are tried in a fork")

MOMENTS = 10
FILES = Path("/proc/self/fd")
Work = Callable[[], None]


def _contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def _moment_in(folder: Path) -> Callable[[int, int], None]:
    """Progress that makes a moment of every image and sweep, beside those of the files."""
    return lambda done, total: sys.audit("os.truncate", folder, done)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    (tmp_path / "out").mkdir()
    return tmp_path / "out"


@pytest.fixture
def write(out: Path) -> Work:
    log = small_log(np.random.default_rng(7))
    return lambda: write_log(log, out / "log", _moment_in(out))


def _moments(work: Work, folder: Path) -> list[int]:
    """Ten spread over the run, which is done once; at the last the log gets its name."""
    count = changes_of(work, folder)
    assert count > MOMENTS
    moments: list[int] = np.linspace(0, count - 1, MOMENTS).round().astype(int).tolist()
    return moments


def test_a_write_killed_at_ten_moments_leaves_no_log_and_is_repeated_with_the_same_bytes(
    write: Work, out: Path, tmp_path: Path
) -> None:
    moments = _moments(write, out)
    whole = _contents(out / "log")
    for moment in moments:
        (out / "log").rename(tmp_path / str(moment))
        assert killed_before(moment, write, out)
        assert not (out / "log").exists()
        write()
        assert _contents(out / "log") == whole
        assert [path.name for path in out.iterdir()] == ["log"]


def test_an_import_killed_ten_times_is_repeated_over_what_the_kills_left(
    tiny_drive: TinyDrive, tmp_path: Path
) -> None:
    # Matching sweeps and finding the road take seconds, before anything is written.
    quick = {"labels": tiny_drive.labels, "refine": False, "with_map": False}
    whole, out = tmp_path / "whole", tmp_path / "out"

    def importing(folder: Path) -> Work:
        return lambda: import_drive(
            "kitti", tiny_drive.root, DRIVE, folder / "log", _moment_in(folder), **quick
        )

    for moment in _moments(importing(whole), whole):
        assert killed_before(moment, importing(out), out)
        assert not (out / "log").exists()
    importing(out)()
    assert [path.name for path in out.iterdir()] == ["log"]
    assert _contents(out / "log") == _contents(whole / "log")


def test_a_full_disk_at_any_size_leaves_nothing(write: Work, out: Path) -> None:
    """Files cannot grow beyond a limit: the kernel's own refusal, of writes, flushes and closes."""
    write()
    sizes = sorted(path.stat().st_size for path in (out / "log").iterdir())
    (out / "log").rename(out.parent / "whole")
    for limit in {0, 1, 512, *(size - 1 for size in sizes)}:
        assert "the file system takes no file of this size" in said_on_a_full_disk(write, limit)
        assert list(out.iterdir()) == []


def _full(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _full_at(moment: int) -> Callable[[int, int], None]:
    return lambda done, total: _full() if done == moment else None


@pytest.mark.skipif(not FILES.is_dir(), reason="the system does not list open files")
def test_a_full_disk_closes_the_stores(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """NCore closes its files only when all is well; tried at every frame and record."""
    log = small_log(np.random.default_rng(7))
    frames = sum(len(one.timestamps_us) for one in (log.cameras["front"], log.lidars["top"]))

    def held() -> list[str]:
        """Files below the output that this process has open."""
        found = []
        for one in FILES.iterdir():
            with suppress(FileNotFoundError):  # the listing itself
                found.append(str(one.readlink()))
        return [file for file in found if file.startswith(str(out))]

    for moment in range(frames + 1):
        with pytest.raises(InputError, match="no space left"):
            write_log(log, out / "log", _full_at(moment))
        assert held() == []
    for record in ("ncore_write._write_sequence_file", "store.LogRecord.model_dump"):
        monkeypatch.setattr(f"recast.logs.{record}", _full)
        with pytest.raises(InputError, match="no space left"):
            write_log(log, out / "log")
        assert held() == []
        monkeypatch.undo()
    assert list(out.iterdir()) == []


def test_a_read_only_disk_is_one_line(write: Work, out: Path) -> None:
    assert "read-only" in said_on_a_read_only_disk(write, out)
    assert list(out.iterdir()) == []
