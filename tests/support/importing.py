"""An import as the command does it: the importer's log, written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from recast.logs import load_log, write_log
from recast.logs.store import WriteProgress


def import_drive(
    importer: str,
    root: Path,
    drive: str,
    out: Path,
    progress: WriteProgress | None = None,
    **options: Any,
) -> None:
    """Import a drive into the new log folder `out`."""
    write_log(load_log(root, importer=importer, drive=drive, **options), out, progress)
