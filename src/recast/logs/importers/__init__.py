"""Importers of other datasets' drives. Each writes the same log folder; see docs/data.md."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from recast.parts import IMPORTERS


class LogImporter(Protocol):
    """Turns one recorded drive of a dataset into a log folder."""

    def __call__(
        self,
        root: Path,
        drive: str,
        out: Path,
        labels: Path | None = None,
        cameras: Sequence[str] = (),
    ) -> None:
        """Import `drive` of the dataset under `root` into the new folder `out`.

        Args:
            root: the dataset's folder.
            drive: the drive's name in the dataset.
            out: log folder to write; it appears whole or not at all.
            labels: box labels where they lie apart from the drive.
            cameras: names of the cameras to import; all if empty.

        Raises:
            InputError: the dataset's files are missing, broken or do not belong together.
        """


__all__ = ["IMPORTERS", "LogImporter"]
