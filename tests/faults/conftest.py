"""A run that nothing disturbed, to compare with."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from faults.children import Ended, Fault, command

TIMES = ("timings.json", "times.json")
"""Say how long something took; all else must be the same bytes."""

OUTPUTS = {
    "actor": ("observation", "actor"),
    "scene": ("scene",),
    "refine": ("refined", "turntable.mp4"),
    "evaluation": ("evaluation",),
    "rollout-advancing-a-replaced": ("rollouts/advancing-a/replaced",),
    "metrics": ("metrics.json",),
    "report": ("report",),
}
"""What each step of a run makes."""


_TIME_ON_A_PAGE = re.compile(rb"<div><span>[^<]*</span><span.* s</span></div>\n")


def contents(folder: Path) -> dict[str, bytes]:
    """All files below a folder, without what says how long something took."""
    return {
        path.relative_to(folder).as_posix(): _TIME_ON_A_PAGE.sub(b"", path.read_bytes())
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in TIMES
    }


@dataclass(frozen=True)
class Unbroken:
    """A finished command.

    Attributes:
        args: of it, without --out.
        out: its folder.
        moments: see `Ended`; relative to the folder that holds `out`.
    """

    args: tuple[str, ...]
    out: Path
    moments: tuple[str, ...]

    def again(self, out: Path, fault: Fault | None = None) -> Ended:
        """The same command on another folder, of the same name or not."""
        number = len(list(out.parent.glob("notes-*")))
        words = [*self.args, "--out", str(out)]
        return command(words, fault or Fault(out.parent), out.parent / f"notes-{number}")

    def without(self, step: str, folder: Path) -> Path:
        """A copy of the run, below `folder`, in which one step is still to do."""
        out = folder / self.out.name
        shutil.copytree(self.out, out)
        (out / "steps" / f"{step}.json").unlink()
        for name in OUTPUTS[step]:
            target = out / name
            shutil.rmtree(target) if target.is_dir() else target.unlink()
        return out

    def same(self, out: Path) -> bool:
        """Whether a folder holds the same bytes."""
        here, there = contents(self.out), contents(out)
        assert sorted(here) == sorted(there)
        assert [name for name in here if here[name] != there[name]] == []
        return True


def unbroken(args: Sequence[str], out: Path) -> Unbroken:
    """Run a command to its end."""
    ended = command([*args, "--out", str(out)], Fault(out.parent), out.parent / "notes")
    assert ended.code == 0, ended.err
    return Unbroken(tuple(args), out, ended.moments)


@pytest.fixture(scope="session")
def finished(tiny_log_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Unbroken:
    """A whole `recast run` at its smallest."""
    args = ["run", str(tiny_log_folder), "--track", "0", "--motion", "advancing-a"]
    args += ["--steps", "10", "--iterations", "4", "--scale", "0.5", "--threads", "1"]
    args += ["--generator", "faults.parts:Box"]
    return unbroken(args, tmp_path_factory.mktemp("finished") / "run")


@pytest.fixture(scope="session")
def finished_grid(tiny_log_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Unbroken:
    """A whole `recast bench` at its smallest; nothing is rendered."""
    args = ["bench", "closed-loop", "--scenes", f"{tiny_log_folder}:0", "--samples", "100"]
    args += ["--motions", "advancing-a", "stationary-a", "--steps", "10"]
    return unbroken(args, tmp_path_factory.mktemp("grid") / "grid")
