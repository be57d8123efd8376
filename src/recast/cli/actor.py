"""`recast actor`: a view-complete vehicle from a log."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Make:
    """Observe a track, generate a vehicle from its best view, register it to box and LiDAR."""

    log: tyro.conf.Positional[Path]
    """Log folder."""
    track: str
    """Track to make; `recast log info LOG` lists them."""
    out: Path
    """Folder to write observation, actor and turntable to; must not exist."""
    generator: str = "template"
    """What makes the vehicle: template, an installed generator's name, or the path of a PLY."""
    cameras: tuple[str, ...] = ()
    """Take the view from this camera; from any where none is named."""
    seed: int = 0
    """Seed of everything random."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.logs import read_log
        from recast.pipeline.actor import make_actor
        from recast.storage import atomic_folder

        with atomic_folder(self.out) as folder:
            actor = make_actor(
                read_log(self.log), self.track, self.generator, self.seed, folder, self.cameras
            )
        console = Console()
        console.print(actor.provenance.observation, markup=False)
        console.print(actor.provenance.registration.explain(), markup=False)
        console.print(f"wrote {self.out}", markup=False)


@dataclass(frozen=True)
class Turntable:
    """Film an actor turning once."""

    actor: tyro.conf.Positional[Path]
    """Actor folder, such as RUN/actor."""
    out: Path
    """Film to write, such as car.mp4."""

    def __call__(self) -> None:
        """Run the command."""
        from recast.actors import load_actor
        from recast.pipeline.actor import film_turntable

        film_turntable(load_actor(self.actor), self.out)


@dataclass(frozen=True)
class Actor:
    """A view-complete vehicle from a log."""

    command: (
        Annotated[Make, tyro.conf.subcommand("make")]
        | Annotated[Turntable, tyro.conf.subcommand("turntable")]
    )

    def __call__(self) -> None:
        """Run the command."""
        self.command()
