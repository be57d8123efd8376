"""`recast recar`: vehicle sets, and the adaptation to vehicles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from recast.cli.recar_data import Ingest, Pack
from recast.cli.recar_perturb import Perturb
from recast.cli.recar_screen import Screen
from recast.cli.recar_small import Assemble, Assets, Autoencoder
from recast.cli.recar_targets import Targets
from recast.cli.recar_train import Train


@dataclass(frozen=True)
class Synth:
    """Render a set of parametric vehicles from all around, background-free, with labels."""

    vehicles: int
    """Number of vehicles."""
    out: Path
    """Set folder; new, or one of the same settings, which is finished or grows."""
    seed: int = 0
    """Seed of everything random."""
    views: int = 30
    """Pictures of each vehicle, at regular azimuths; the first one shows its front."""
    width: int = 1200
    """Of the pictures, pixels."""
    height: int = 800
    """Of the pictures, pixels."""
    kinds: tuple[str, ...] = ()
    """Only these kinds, evenly; all, as often as on the road, where none is named."""
    shapes: int = 0
    """Number of other shapes: furniture, signs and the like."""
    mesh: tyro.conf.UseAppendAction[tuple[Path, ...]] = ()
    """A closed mesh of your own (glTF, OBJ, PLY, STL); may be given again."""
    mesh_axes: str | None = None
    """Forward and up axes of the meshes, such as x,z (write --mesh-axes=-y,z with a minus); by the
    format where not given: z,y for glTF, x,z for all others."""
    licence: str = "CC0-1.0"
    """Licence of the pictures, for set.json."""
    held_out: float = 0.05
    """Share of the vehicles that is never trained on; the default is the paper's."""
    workers: int = 1
    """Processes; the files are the same for any number."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.recar import SynthesisSettings, synthesize_set
        from recast.recar.progress import PictureProgress

        settings = SynthesisSettings(
            self.seed, self.views, self.width, self.height, self.kinds, self.licence,
            self.held_out,
        )  # fmt: skip
        console = Console()
        with PictureProgress("pictures", console) as progress:
            made = synthesize_set(
                self.out,
                self.vehicles,
                settings,
                shapes=self.shapes,
                meshes=self.mesh,
                mesh_axes=self.mesh_axes,
                workers=self.workers,
                progress=progress,
            )
        console.print(f"wrote {self.out}: {len(made.identities)} identities", markup=False)


@dataclass(frozen=True)
class Stats:
    """Count what is in a set, check its pictures, and draw its figure."""

    set: tyro.conf.Positional[Path]
    """Set folder, or a folder of shards."""
    out: Path | None = None
    """Folder for dataset.png, views.png, colours.png and types.png."""
    decode: bool = False
    """Check every pixel instead of every header; minutes to hours."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.recar import set_statistics, statistics_table
        from recast.recar.figure import FIGURE_FILES, write_figure
        from recast.recar.progress import PictureProgress
        from recast.recar.shards import open_set

        vehicle_set = open_set(self.set)
        console = Console()
        with PictureProgress("checked", console) as progress:
            vehicle_set.check_pictures(self.decode, progress)
        statistics = set_statistics(vehicle_set)
        console.print(statistics_table(vehicle_set, statistics))
        if self.out is not None:
            write_figure(vehicle_set, statistics, self.out)
            console.print(f"wrote {', '.join(FIGURE_FILES)} in {self.out}", markup=False)


@dataclass(frozen=True)
class Recar:
    """Vehicle sets, and the adaptation of the image-to-3D model to vehicles."""

    command: (
        Annotated[Synth, tyro.conf.subcommand("synth")]
        | Annotated[Stats, tyro.conf.subcommand("stats")]
        | Annotated[Ingest, tyro.conf.subcommand("ingest")]
        | Annotated[Pack, tyro.conf.subcommand("pack")]
        | Annotated[Targets, tyro.conf.subcommand("targets")]
        | Annotated[Perturb, tyro.conf.subcommand("perturb")]
        | Annotated[Screen, tyro.conf.subcommand("screen")]
        | Annotated[Train, tyro.conf.subcommand("train")]
        | Annotated[Assets, tyro.conf.subcommand("assets")]
        | Annotated[Autoencoder, tyro.conf.subcommand("autoencoder")]
        | Annotated[Assemble, tyro.conf.subcommand("assemble")]
    )

    def __call__(self) -> None:
        """Run the command."""
        self.command()
