"""`recast recar ingest` and `recast recar pack`: sets of photographs, and sets in shards."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class Ingest:
    """Make a set of photographs: a folder for each vehicle, and a table about them."""

    photos: tyro.conf.Positional[Path]
    """Folder with vehicles.csv (or .json) and a folder of photographs for each vehicle."""
    out: Path
    """Set folder; new, or one of the same options, which is finished or grows."""
    licence: str
    """Licence of the photographs, of vehicles whose row names none."""
    source: str = "photographs"
    """Where they are from, in words."""
    table: Path | None = None
    """The table, where it does not lie beside the folders."""
    layout: Literal["regular", "3drealcar", "mad-cars"] = "regular"
    """How photographs lie: at regular azimuths; or walk-arounds with camera poses, of which views
    near regular azimuths are taken. 3drealcar and mad-cars are experimental: they have not met real
    data."""
    views: int = 30
    """Views of each vehicle, at regular azimuths."""
    azimuth_within: float | None = None
    """With a walk-around: degrees by which a photograph may be off its azimuth; half of the step
    between two views if not given."""
    width: int = 1200
    """Of the pictures in the set, pixels."""
    height: int = 800
    """Of the pictures in the set, pixels."""
    clockwise: bool = False
    """The photographs go around the vehicle clockwise, seen from above."""
    elevation: float | None = None
    """Degrees of the camera above the horizontal, where it was measured."""
    fov: float | None = None
    """Degrees across the width of a photograph, where it was measured."""
    remover: str = "grabcut"
    """What removes backgrounds where nothing is transparent: grabcut, a folder that holds
    grounding-dino and sam, or none."""
    duplicate_bits: int = 20
    """Two pictures whose hashes differ in no more of 255 bits are the same one."""
    split_seed: int = 0
    """Of the split into train and held-out."""
    held_out: float = 0.05
    """Share of vehicles that is held out of training."""
    skip_bad: bool = False
    """Leave bad vehicles out; they are listed in ingest.json."""
    workers: int = 1
    """Processes; the files are the same for any number."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.actors.grounded_cutout import remover_of
        from recast.errors import InputError, printable
        from recast.recar.ingest import EXPERIMENTAL, IngestSettings, ingest_photographs
        from recast.recar.progress import PictureProgress

        settings = IngestSettings(
            self.licence, self.source, self.views, self.width, self.height, self.clockwise,
            self.elevation, self.fov, self.split_seed, self.held_out, self.duplicate_bits,
            self.layout, self.azimuth_within,
        )  # fmt: skip
        remover = None if self.remover == "none" else remover_of(self.remover)
        console = Console()
        if self.layout in EXPERIMENTAL:
            console.print(
                f"note: {self.layout} is experimental, it has not met real data: look at the set",
                markup=False,
            )

        def show(name: str, error: InputError) -> None:
            console.print(f"{printable(name)}: {error}", markup=False, soft_wrap=True)

        with PictureProgress("pictures", console) as progress:
            report = ingest_photographs(
                self.photos, self.out, settings, remover, table=self.table, skip_bad=self.skip_bad,
                workers=self.workers, progress=progress,
                on_bad=show,
            )  # fmt: skip
        doubtful = sum(1 for lines in report.doubts.values() if lines)
        console.print(
            f"wrote {self.out}: {len(report.vehicle_set.identities)} identities, "
            f"{len(report.skipped)} left out, {doubtful} to look at, see ingest.json",
            markup=False,
            soft_wrap=True,
        )


@dataclass(frozen=True)
class Pack:
    """Pack a set into tar shards, which stream (WebDataset) and are read at any identity."""

    set: tyro.conf.Positional[Path]
    """Set folder."""
    out: Path
    """Folder of the shards; new, or shards of the same set, which are finished or mended."""
    shard_bytes: str = "256MB"
    """Size that no shard exceeds, such as 256MB or 1GiB."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.recar import read_set
        from recast.recar.progress import PictureProgress
        from recast.recar.shards import pack_set, parse_byte_size

        shard_bytes = parse_byte_size(self.shard_bytes, "--shard-bytes")
        vehicle_set = read_set(self.set)
        console = Console()
        with PictureProgress("pictures", console) as progress:
            index = pack_set(vehicle_set, self.out, shard_bytes, progress)
        console.print(
            f"wrote {self.out}: {index.identities} identities in {len(index.shards)} shards, "
            f"{index.bytes / 1e6:,.1f} MB",
            markup=False,
            soft_wrap=True,
        )
