"""`recast scene import`: scenes that others trained."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from recast.cli import shared
from recast.cli.output import console_for

if TYPE_CHECKING:
    from recast.scene.importers import ImportRecord


WORLD_FROM_SCENE = shared.option(
    "Text file with a 4x4 matrix or an offset from the scene's coordinates to the log's world.",
    metavar="PATH",
)


@dataclass(frozen=True)
class StreetGaussians:
    """Import a checkpoint of Street Gaussians (trained_model/iteration_N.pth)."""

    checkpoint: tyro.conf.Positional[Path]
    """Checkpoint file; code in it is not executed."""
    log: Path
    """Log folder of the drive that the scene was trained on."""
    out: Path
    """Scene folder to write; must not exist."""
    processed: Annotated[
        Path | None,
        shared.option(
            "Processed folder of the training: gives the exact place of the scene and the learned "
            "poses of the actors.",
            "an approximate place, and the log's poses",
            metavar="PATH",
        ),
    ] = None
    frames: Annotated[
        tuple[int, int] | None,
        shared.option(
            "First and last frame of the training.",
            "all of the processed folder",
            metavar="FIRST LAST",
        ),
    ] = None
    cameras: tuple[int, ...] = (0, 1, 2)
    """Numbers of the cameras of the training."""
    world_from_scene: Annotated[Path | None, WORLD_FROM_SCENE] = None
    tracks: Annotated[
        Path | None,
        shared.option(
            'JSON file with the log\'s track id of each actor: {"obj_003": "..."}.', metavar="PATH"
        ),
    ] = None
    leave_out: tuple[str, ...] = ()
    """Actors to leave out, such as obj_003."""
    share: float = 0.5
    """Time at which the time-dependent colours of an actor are frozen, as a fraction (0 to 1) of
    its track."""

    def __call__(self) -> None:
        """Run the command."""
        from recast.logs import read_log
        from recast.scene.importers import import_street_gaussians

        record = import_street_gaussians(
            self.checkpoint,
            read_log(self.log),
            self.out,
            processed=self.processed,
            frames=self.frames,
            cameras=self.cameras,
            world_from_scene=self.world_from_scene,
            tracks=self.tracks,
            leave_out=self.leave_out,
            share=self.share,
        )
        _tell(record, self.out)


@dataclass(frozen=True)
class DriveStudio:
    """Import a checkpoint of DriveStudio (checkpoint_final.pth): OmniRe and others."""

    checkpoint: tyro.conf.Positional[Path]
    """Checkpoint file; code in it is not executed."""
    log: Path
    """Log folder of the drive that the scene was trained on."""
    out: Path
    """Scene folder to write; must not exist."""
    processed: Annotated[
        Path | None,
        shared.option(
            "Processed folder of the training: its first pose places the scene.",
            "the log's pose at the first frame",
            metavar="PATH",
        ),
    ] = None
    first_frame: int = 0
    """First time step of the training."""
    clock: Annotated[
        str | None,
        shared.option(
            "Sensor of the log whose frames are the time steps of the checkpoint.",
            "the LiDAR, else the camera, with most frames",
            metavar="NAME",
        ),
    ] = None
    world_from_scene: Annotated[Path | None, WORLD_FROM_SCENE] = None
    tracks: Annotated[
        Path | None,
        shared.option(
            'JSON file with the log\'s track id of each actor: {"0": "..."}.',
            "the track at the same place",
            metavar="PATH",
        ),
    ] = None
    leave_out: tuple[str, ...] = ()
    """Numbers of the actors to leave out."""
    share: float = 0.5
    """Time at which the view-dependent colours of an actor are frozen, as a fraction (0 to 1) of
    its track."""

    def __call__(self) -> None:
        """Run the command."""
        from recast.logs import read_log
        from recast.scene.importers import import_drivestudio

        record = import_drivestudio(
            self.checkpoint,
            read_log(self.log),
            self.out,
            processed=self.processed,
            first_frame=self.first_frame,
            clock=self.clock,
            world_from_scene=self.world_from_scene,
            tracks=self.tracks,
            leave_out=self.leave_out,
            share=self.share,
        )
        _tell(record, self.out)


@dataclass(frozen=True)
class Ply:
    """Import a PLY of 3D Gaussian splatting as a static background."""

    background: tyro.conf.Positional[Path]
    """PLY file."""
    log: Path
    """Log folder of the drive."""
    out: Path
    """Scene folder to write; must not exist."""
    world_from_ply: Annotated[
        Path | None,
        shared.option(
            "Text file with a 4x4 matrix (it may scale) or an offset from the PLY's coordinates to "
            "the log's world.",
            "the same coordinates",
            metavar="PATH",
        ),
    ] = None
    sky: Annotated[
        Path | None,
        shared.option(
            "Equirectangular sky image, as `recast scene export` writes it.",
            "a black sky",
            metavar="PATH",
        ),
    ] = None

    def __call__(self) -> None:
        """Run the command."""
        from recast.logs import read_log
        from recast.scene.importers import import_ply

        record = import_ply(
            self.background, read_log(self.log), self.out, self.world_from_ply, self.sky
        )
        _tell(record, self.out)


@dataclass(frozen=True)
class Import:
    """Import a scene that another program trained (docs/scenes.md)."""

    command: (
        Annotated[StreetGaussians, tyro.conf.subcommand("street-gaussians")]
        | Annotated[DriveStudio, tyro.conf.subcommand("drivestudio")]
        | Annotated[Ply, tyro.conf.subcommand("ply")]
    )

    def __call__(self) -> None:
        """Run the command."""
        self.command()


def _tell(record: ImportRecord, out: Path) -> None:
    from recast.cli.rows.logs import import_lines

    console = console_for(False)
    for line, style in import_lines(record):
        console.print(line, style=style, markup=False, highlight=False)
    console.print(f"wrote {out}", markup=False)
