"""`recast log`: bring logs in, look at them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Import:
    """Import a recorded drive into the log folder that everything else reads."""

    importer: tyro.conf.Positional[str]
    """Kind of the dataset: kitti (raw, synced and rectified), or an installed importer."""
    root: tyro.conf.Positional[Path]
    """The dataset's folder; for kitti the one that holds the date folder, such as 2011_09_26."""
    drive: str
    """Name of the drive, such as 2011_09_26_drive_0013."""
    out: Path
    """Log folder to write; must not exist."""
    labels: Path | None = None
    """Box labels that lie apart from the drive; for kitti a tracking label file. Without it, the
    drive's own tracklet_labels.xml is read."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.logs.importers import IMPORTERS, LogImporter

        importer: LogImporter = IMPORTERS.load(self.importer)
        console = Console()
        with console.status(f"importing {self.drive}"):
            importer(self.root, self.drive, self.out, self.labels)
        console.print(f"wrote {self.out}; next: recast log info {self.out}", markup=False)


@dataclass(frozen=True)
class Info:
    """Print sensors, duration and tracks: how far each moves and from which sides it was seen."""

    log: tyro.conf.Positional[Path]
    """Log folder."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.logs import log_info, read_log
        from recast.reporting.log_tables import log_info_tables

        Console().print(*log_info_tables(log_info(read_log(self.log))), sep="\n")


@dataclass(frozen=True)
class Log:
    """Bring logs in, look at them."""

    command: (
        Annotated[Import, tyro.conf.subcommand("import")]
        | Annotated[Info, tyro.conf.subcommand("info")]
    )

    def __call__(self) -> None:
        """Run the command."""
        self.command()
