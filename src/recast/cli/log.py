"""`recast log`: bring logs in, look at them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class ImportKitti:
    """Import a KITTI raw drive (synced and rectified)."""

    root: tyro.conf.Positional[Path]
    """Folder that holds the date folder, such as 2011_09_26."""
    drive: str
    """Name of the drive, such as 2011_09_26_drive_0013."""
    out: Path
    """Folder to write the log to; must not exist."""
    labels: Path | None = None
    """KITTI tracking label file of this drive. Without it, tracklet_labels.xml is read."""
    cameras: tuple[str, ...] = ("image_02",)
    """Colour cameras to take: image_02, image_03."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.logs.importers.kitti import import_kitti

        import_kitti(self.root, self.drive, self.out, self.labels, self.cameras)
        Console().print(f"wrote {self.out}; next: [bold]recast log info {self.out}[/bold]")


@dataclass(frozen=True)
class Import:
    """Import a recorded drive into the log store that everything else reads."""

    command: Annotated[ImportKitti, tyro.conf.subcommand("kitti")]

    def __call__(self) -> None:
        """Run the command."""
        self.command()


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
