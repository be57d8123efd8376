"""Disks that are full or read-only: one line, exit code 2, and the same command goes on later."""

from __future__ import annotations

import errno
import shutil
from pathlib import Path

import pytest

from faults.small_run import small_run
from support.children import Ended, Fault, refused_from
from support.unbroken import STEPS, Unbroken, contents, kept, stamps

pytestmark = pytest.mark.whole

WORDS = {
    errno.ENOSPC: "no space left",
    errno.EROFS: "read-only",
    errno.EACCES: "permission denied",
    errno.EFBIG: "takes no file of this size",
    errno.ESTALE: "Stale file handle",  # one that nobody foresaw
}


def refused(ended: Ended, kind: int) -> bool:
    """Whether a command ended in one line that says what the disk refused."""
    lines = ended.err.splitlines()
    assert (ended.code, len(lines)) == (2, 1), ended.err
    assert lines[0].startswith("recast: ") and WORDS[kind] in lines[0], lines[0]
    return True


@pytest.mark.parametrize("step", STEPS)
def test_every_step_of_a_run(finished: Unbroken, tmp_path: Path, step: str) -> None:
    """The first, a middle and the last changes meet a full disk, a read-only one, no permission."""
    first = finished.without(step, tmp_path / "0")
    changes = len(finished.again(first).moments)
    assert finished.same(first)
    faults = (
        (errno.ENOSPC, 1),
        (errno.EROFS, 1),
        (errno.EACCES, changes // 3),
        (errno.ENOSPC, changes // 2),
        (errno.ENOSPC, changes - 2),
    )
    for number, (kind, at) in enumerate(faults, 1):
        out = finished.without(step, tmp_path / str(number))
        before = stamps(out)
        assert refused(finished.again(out, Fault(out.parent, kind, at)), kind)
        assert kept(before, out)
    assert finished.again(out).code == 0
    assert kept(before, out) and finished.same(out)


@pytest.mark.parametrize("step", STEPS)
def test_files_that_must_not_grow(finished: Unbroken, tmp_path: Path, step: str) -> None:
    """A limit of the system holds for what libraries write by themselves, such as films."""
    out = finished.without(step, tmp_path / "1")
    before = stamps(out)
    sizes = [path.stat().st_size for path in files(finished.place(step))]
    sizes = [size for size in sizes if size > 1000]  # a message takes some, too
    for limit in {min(sizes) - 1, max(sizes) - 1}:
        ended = finished.again(out, Fault(out.parent, file_limit=limit))
        assert refused(ended, errno.EFBIG)
    assert finished.again(out).code == 0
    assert kept(before, out) and finished.same(out)


def files(path: Path) -> list[Path]:
    """The file itself, or all below a folder."""
    return [path] if path.is_file() else [one for one in path.rglob("*") if one.is_file()]


@pytest.mark.parametrize("kind", [errno.ENOSPC, errno.EROFS, errno.EACCES, errno.ESTALE])
def test_the_start_of_a_run(finished: Unbroken, tmp_path: Path, kind: int) -> None:
    out = tmp_path / "run"
    assert refused(finished.again(out, Fault(tmp_path, kind, 1)), kind)
    assert not out.exists()
    assert refused(finished.again(out, Fault(tmp_path / "store", kind, 1)), kind)
    assert not (tmp_path / "store").exists(), "another disk than that of the run"


def test_a_finished_run_changes_nothing_and_needs_no_disk(
    finished: Unbroken, tmp_path: Path
) -> None:
    for name in (finished.out.name, "store"):
        shutil.copytree(finished.out.parent / name, tmp_path / "1" / name, symlinks=True)
    ended = finished.again(tmp_path / "1" / finished.out.name, Fault(tmp_path, errno.EROFS, 1))
    assert (ended.code, ended.moments) == (0, ()), ended.err


@pytest.mark.parametrize("kind", [errno.ENOSPC, errno.EROFS])
def test_every_quarter_of_a_grid(finished_grid: Unbroken, tmp_path: Path, kind: int) -> None:
    changes = len(finished_grid.moments)
    for number, at in enumerate((1, changes // 4, changes // 2, changes - 2)):
        out = tmp_path / str(number) / "grid"
        out.parent.mkdir()
        assert refused(finished_grid.again(out, Fault(out.parent, kind, at)), kind)
        before = stamps(out)
        assert finished_grid.again(out).code == 0
        assert kept(before, out) and finished_grid.same(out)


@pytest.mark.parametrize("kind", [errno.ENOSPC, errno.EROFS])
def test_every_change_of_a_run_folder_and_its_store(tmp_path: Path, kind: int) -> None:
    whole = contents(small_run(tmp_path / "whole"))
    change, went_on = 0, True
    while went_on:
        change += 1
        folder = tmp_path / str(change)
        went_on = refused_from(change, kind, lambda to=folder: small_run(to), folder)
        before = stamps(folder / "run")
        assert contents(small_run(folder)) == whole
        assert kept(before, folder / "run")
    assert change > 60
