"""Importers of other datasets' drives: each returns a driving log; see docs/data.md."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from recast.core.plugins import IMPORTERS
from recast.logs.types import DrivingLog


class LogImporter(Protocol):
    """Reads one recorded drive of a dataset as a driving log."""

    def __call__(
        self,
        root: Path,
        drive: str,
        labels: Path | None = None,
        cameras: Sequence[str] = (),
    ) -> DrivingLog:
        """The log of `drive` in the dataset under `root`; nothing is written.

        It may have further options, with defaults.

        Args:
            root: the dataset's folder.
            drive: the drive's name in the dataset.
            labels: box labels that lie apart from the drive.
            cameras: names of the cameras to import; all if empty.

        Returns:
            the log in recast's frames and units, see `DrivingLog`; images and sweeps are lazy
            sequences, so that a long drive needs no more memory than a short one.

        Raises:
            InputError: the dataset's files are missing, broken or do not belong together.
        """


__all__ = ["IMPORTERS", "LogImporter"]
