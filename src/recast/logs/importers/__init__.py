"""Importers of other datasets' drives. Each writes the same log folder; see docs/data.md."""

from __future__ import annotations

import importlib
from importlib.metadata import entry_points
from pathlib import Path
from typing import Protocol

from recast.errors import InputError

ENTRY_POINTS = "recast.importers"
BUILT_IN = {"kitti": "recast.logs.importers.kitti:import_kitti"}


class LogImporter(Protocol):
    """Turns one recorded drive of a dataset into a log folder."""

    def __call__(self, root: Path, drive: str, out: Path, labels: Path | None = None) -> None:
        """Import `drive` of the dataset under `root` into the new folder `out`.

        Args:
            root: the dataset's folder.
            drive: the drive's name in the dataset.
            out: log folder to write; it appears whole or not at all.
            labels: box labels where they lie apart from the drive.

        Raises:
            InputError: the dataset's files are missing, broken or do not belong together.
        """


def importer_names() -> list[str]:
    """Names of all importers: ours and those installed under the entry point `recast.importers`."""
    return sorted({*BUILT_IN, *(point.name for point in entry_points(group=ENTRY_POINTS))})


def find_importer(name: str) -> LogImporter:
    """The importer of that name.

    Raises:
        InputError: there is none.
    """
    if name in BUILT_IN:
        module, _, attribute = BUILT_IN[name].partition(":")
        importer: LogImporter = getattr(importlib.import_module(module), attribute)
        return importer
    for point in entry_points(group=ENTRY_POINTS, name=name):
        loaded: LogImporter = point.load()
        return loaded
    raise InputError(
        name, "importer", "is not installed", f"choose one of {', '.join(importer_names())}"
    )


__all__ = ["LogImporter", "find_importer", "importer_names"]
