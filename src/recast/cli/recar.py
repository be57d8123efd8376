"""`recast recar`: vehicle sets, and the adaptation to vehicles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from recast.cli import shared
from recast.cli.output import JSON, console_for, print_json
from recast.cli.recar_sets import Ingest, Pack, Perturb, Screen
from recast.cli.recar_targets import Targets
from recast.cli.recar_train import Assemble, Assets, Autoencoder, Train


@dataclass(frozen=True)
class Synth:
    """Render a set of parametric vehicles from all sides, with labels and without background."""

    vehicles: int
    """Number of vehicles."""
    out: Path
    """Set folder; the same command resumes, and a set of the same settings grows."""
    seed: Annotated[int, shared.SEED] = 0
    views: int = 30
    """Number of pictures of each vehicle, at regular azimuths; the first shows its front."""
    width: int = 1200
    """Width of the pictures in pixels."""
    height: int = 800
    """Height of the pictures in pixels."""
    kinds: Annotated[
        tuple[str, ...],
        shared.option(
            "Kinds of vehicles, each equally often.",
            "all, as often as on the road",
            metavar="KIND [KIND ...]",
        ),
    ] = ()
    shapes: int = 0
    """Number of other shapes, such as furniture and signs."""
    mesh: Annotated[
        tyro.conf.UseAppendAction[tuple[Path, ...]],
        shared.option("Closed mesh (glTF, OBJ, PLY, STL) to include. May be repeated."),
    ] = ()
    mesh_axes: Annotated[
        str | None,
        shared.option(
            "Forward and up axes of the meshes, such as x,z (write --mesh-axes=-y,z with a minus).",
            "z,y for glTF, x,z for other formats",
            metavar="AXES",
        ),
    ] = None
    licence: str = "CC0-1.0"
    """Licence of the pictures, written to set.json."""
    held_out: float = 0.05
    """Share of the vehicles that is held out of training (0 to 1)."""
    workers: Annotated[int, shared.WORKERS] = 1

    def __call__(self) -> None:
        """Run the command."""
        from recast.recar import SynthesisSettings, synthesize_set
        from recast.recar.progress import PictureProgress

        settings = SynthesisSettings(
            self.seed,
            self.views,
            self.width,
            self.height,
            self.kinds,
            self.licence,
            self.held_out,
        )
        console = console_for(False)
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
    """Count the vehicles of a set, check its pictures, and draw its figure."""

    set: tyro.conf.Positional[Path]
    """Set folder, or a folder of shards."""
    out: Annotated[
        Path | None,
        shared.option(
            "Folder for dataset.png, views.png, colours.png and types.png.",
            "no pictures",
            metavar="PATH",
        ),
    ] = None
    decode: bool = False
    """Check every pixel instead of every header (minutes to hours)."""
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        """Run the command."""
        from recast.recar import set_statistics, statistics_table
        from recast.recar.figure import FIGURE_FILES, write_figure
        from recast.recar.progress import PictureProgress
        from recast.recar.shards import open_set

        vehicle_set = open_set(self.set)
        console = console_for(self.json)
        with PictureProgress("checked", console) as progress:
            vehicle_set.check_pictures(self.decode, progress)
        statistics = set_statistics(vehicle_set)
        if self.json:
            from recast.cli.rows.vehicles import set_rows

            print_json(set_rows(statistics))
        else:
            console.print(statistics_table(vehicle_set, statistics))
        if self.out is not None:
            write_figure(vehicle_set, statistics, self.out)
            console.print(f"wrote {', '.join(FIGURE_FILES)} in {self.out}", markup=False)


@dataclass(frozen=True)
class Recar:
    """Make vehicle sets, and adapt the image-to-3D model to vehicles."""

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
