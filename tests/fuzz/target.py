"""A reader under test, and the list of all."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from importlib import import_module
from pathlib import Path
from typing import Any

GROUPS = ("importers", "logs", "scenes", "models", "sets", "runs", "protocols")
"""Modules of `fuzz.targets`, each with a tuple TARGETS."""


@dataclass(frozen=True)
class Target:
    """A reader of foreign files.

    Attributes:
        name: unique, a plain word.
        write: fills an empty folder with a sample that the reader accepts.
        read: reads the folder; may write below its second argument, a path that does not exist
            yet. Returns what was read, in which every number is checked to be finite.
        files: patterns of the sample's files to damage, by relative path.
        weight: inputs of this target, in relation to others; less where a reading is slow.
        resumes: whether the reader keeps what it finished before a fault, for the next try.
    """

    name: str
    write: Callable[[Path], object]
    read: Callable[[Path, Path], Any]
    files: tuple[str, ...] = ("*",)
    weight: float = 1.0
    resumes: bool = False

    def members(self, folder: Path) -> list[str]:
        """Relative paths of the files to damage, sorted."""
        names = (p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())
        found = sorted(n for n in names if any(fnmatch(n, pattern) for pattern in self.files))
        assert found, f"{self.name}: no file of the sample matches {self.files}"
        return found


def all_targets() -> dict[str, Target]:
    """Every target by name."""

    def listed() -> Iterator[Target]:
        for group in GROUPS:
            yield from import_module(f"fuzz.targets.{group}").TARGETS

    found: dict[str, Target] = {}
    for target in listed():
        assert target.name not in found, target.name
        found[target.name] = target
    return found
