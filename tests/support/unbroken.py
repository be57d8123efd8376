"""A command that nothing disturbed, to compare with."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from recast.core import files
from support.children import Ended, Fault, command

TIMES = ("times.json",)
"""Say how long something took; all else must be the same bytes."""
STEPS = (
    "scene/recast",
    "evaluation/recast",
    "registered/replaced",
    "actor/replaced",
    "turntable/replaced",
    "rollout/advancing-a/idm-follower/replaced",
    "metrics.json",
    "report",
)
"""What a run makes: artefacts by their uses, and its own files."""
_TIME_ON_A_PAGE = re.compile(rb"<div><span>[^<]*</span><span.* s</span></div>\n")
_TIME_OF_AN_ARTEFACT = re.compile(rb'"seconds": [0-9.]+')


def contents(folder: Path) -> dict[str, bytes]:
    """All files and links below a folder, without what says how long something took."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            found[name] = str(path.readlink()).encode()
        elif path.is_file() and path.name == "artefact.json":
            found[name] = _TIME_OF_AN_ARTEFACT.sub(b"", path.read_bytes())
        elif path.is_file() and path.name not in TIMES:
            found[name] = _TIME_ON_A_PAGE.sub(b"", path.read_bytes())
    return found


def stamps(out: Path) -> dict[Path, int]:
    """The finished artefacts of the store beside a folder, and when each was made."""
    records = (out.parent / "store").glob("*/[!.]*/artefact.json")
    return {path: path.stat().st_mtime_ns for path in records}


def kept(before: dict[Path, int], out: Path) -> bool:
    """Whether all artefacts that were finished before are there and were not made again."""
    return before.items() <= stamps(out).items()


@dataclass(frozen=True)
class Unbroken:
    """A finished command.

    Attributes:
        args: of it, without --out.
        out: its folder; the store lies beside it.
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

    def place(self, step: str, out: Path | None = None) -> Path:
        """Where a run in the folder `out` has one of `STEPS`, whole."""
        out = out or self.out
        reference = files.read_json(self.out / "run.json")["artefacts"].get(step)
        return out / step if reference is None else out.parent / "store" / reference

    def without(self, step: str, folder: Path) -> Path:
        """A copy of run and store, below `folder`, in which one of `STEPS` is still to do."""
        out = folder / self.out.name
        for name in (self.out.name, "store"):
            shutil.copytree(self.out.parent / name, folder / name, symlinks=True)
        target = self.place(step, out)
        shutil.rmtree(target) if target.is_dir() else target.unlink()
        record = files.read_json(out / "run.json")
        record["artefacts"].pop(step, None)
        files.write_json(out / "run.json", record)
        return out

    def same(self, out: Path) -> bool:
        """Whether a folder and the store beside it hold the same bytes."""
        stores = self.out.parent / "store", out.parent / "store"
        for one, other in ((self.out, out), stores):
            here, there = contents(one), contents(other)
            assert sorted(here) == sorted(there)
            assert [name for name in here if here[name] != there[name]] == []
        return True


def unbroken(args: Sequence[str], out: Path) -> Unbroken:
    """Run a command to its end; `out` lies two folders deep, as those that it is compared with."""
    out.parent.mkdir(exist_ok=True)
    ended = command([*args, "--out", str(out)], Fault(out.parent), out.parent / "notes")
    assert ended.code == 0, ended.err
    return Unbroken(tuple(args), out, ended.moments)
