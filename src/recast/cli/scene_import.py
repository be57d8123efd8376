"""`recast scene import`: scenes that others trained."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from recast.scene.importers import ImportRecord


@dataclass(frozen=True)
class StreetGaussians:
    """A checkpoint of Street Gaussians (trained_model/iteration_N.pth)."""

    checkpoint: tyro.conf.Positional[Path]
    """Checkpoint; no code in it is run."""
    log: Path
    """Log folder of the drive it was trained on."""
    out: Path
    """Scene folder to write; must not exist."""
    processed: Path | None = None
    """The processed folder it was trained on: places the scene exactly, and actors as learned.
    Without it the scene's place is only near, and actors follow the log."""
    frames: tuple[int, int] | None = None
    """First and last frame of the training; all of the processed folder if not given."""
    cameras: tuple[int, ...] = (0, 1, 2)
    """Numbers of the cameras of the training."""
    world_from_scene: Path | None = None
    """Text file with a 4x4 matrix or an offset from the scene's coordinates to the log's world."""
    tracks: Path | None = None
    """JSON file with the log's track ids by actor: {"obj_003": "..."}."""
    leave_out: tuple[str, ...] = ()
    """Actors not wanted, such as obj_003."""
    share: float = 0.5
    """Where in an actor's time, from 0 to 1, its changing colour is frozen."""

    def __call__(self) -> None:
        """Run the command."""
        from recast.logs import read_log
        from recast.scene.importers import import_street_gaussians

        record = import_street_gaussians(
            self.checkpoint, read_log(self.log), self.out,
            processed=self.processed, frames=self.frames, cameras=self.cameras,
            world_from_scene=self.world_from_scene, tracks=self.tracks,
            leave_out=self.leave_out, share=self.share,
        )  # fmt: skip
        _tell(record, self.out)


@dataclass(frozen=True)
class DriveStudio:
    """A checkpoint of DriveStudio (checkpoint_final.pth): OmniRe and others."""

    checkpoint: tyro.conf.Positional[Path]
    """Checkpoint; no code in it is run."""
    log: Path
    """Log folder of the drive it was trained on."""
    out: Path
    """Scene folder to write; must not exist."""
    processed: Path | None = None
    """The processed folder it was trained on: its first pose places the scene. Without it, the
    log's rig at the first frame does."""
    first_frame: int = 0
    """First time step of the training."""
    clock: str | None = None
    """Sensor of the log whose frames are the checkpoint's; its LiDAR, else its camera, with most
    frames if not given."""
    world_from_scene: Path | None = None
    """Text file with a 4x4 matrix or an offset from the scene's coordinates to the log's world."""
    tracks: Path | None = None
    """JSON file with the log's track ids by actor: {"0": "..."}. Others are told by place."""
    leave_out: tuple[str, ...] = ()
    """Actors not wanted, by number."""
    share: float = 0.5
    """Where in an actor's time, from 0 to 1, its view-dependent colour is kept."""

    def __call__(self) -> None:
        """Run the command."""
        from recast.logs import read_log
        from recast.scene.importers import import_drivestudio

        record = import_drivestudio(
            self.checkpoint, read_log(self.log), self.out,
            processed=self.processed, first_frame=self.first_frame, clock=self.clock,
            world_from_scene=self.world_from_scene, tracks=self.tracks,
            leave_out=self.leave_out, share=self.share,
        )  # fmt: skip
        _tell(record, self.out)


@dataclass(frozen=True)
class Ply:
    """A PLY of 3D Gaussian splatting, as a static background."""

    background: tyro.conf.Positional[Path]
    """PLY file."""
    log: Path
    """Log folder of the drive."""
    out: Path
    """Scene folder to write; must not exist."""
    world_from_ply: Path | None = None
    """Text file with a 4x4 matrix, which may scale, or an offset from the PLY's coordinates to the
    log's world. Without it they are the same."""
    sky: Path | None = None
    """Equirectangular sky image, as export writes it; black if not given."""

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
    """Bring in a scene that another program trained; see docs/scenes.md."""

    command: (
        Annotated[StreetGaussians, tyro.conf.subcommand("street-gaussians")]
        | Annotated[DriveStudio, tyro.conf.subcommand("drivestudio")]
        | Annotated[Ply, tyro.conf.subcommand("ply")]
    )

    def __call__(self) -> None:
        """Run the command."""
        self.command()


def _tell(record: ImportRecord, out: Path) -> None:
    from rich.console import Console

    from recast.reporting.scene_tables import import_lines

    console = Console()
    for line, style in import_lines(record):
        console.print(line, style=style, markup=False, highlight=False)
    console.print(f"wrote {out}", markup=False)
