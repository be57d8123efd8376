"""`recast serve`: recast as the renderer of other simulators."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from recast.cli import shared
from recast.cli.shared import console_for
from recast.core import diagnostics

_WORLD_FROM_LOCAL = (
    "Text file with a 4x4 matrix or an offset from the requests' coordinates to the log's world."
)


@dataclass(frozen=True)
class _Scenes:
    """Options of what is served, and where."""

    scene: Annotated[tyro.conf.Positional[tuple[str, ...]], shared.several("SCENE...")]
    """Scene folder or run folder; ID=FOLDER chooses the scene's id, else it is the name of its
    log. The id of a run is followed by -ARM, unless --arm chooses one."""
    log: Annotated[
        shared.Names,
        shared.option(
            "Log folder of a scene folder: it has the cameras. May be repeated.", metavar="PATH"
        ),
    ] = ()
    arm: Annotated[
        str | None, shared.option("Arm of the run folders to serve, such as replaced.", "all arms")
    ] = None
    host: str = "127.0.0.1"
    """Address to listen on. The default can be reached from this machine only; 0.0.0.0 lets
    everybody in your network ask for images. The channel is not secured."""
    threads: Annotated[int, shared.THREADS] = 0
    device: Annotated[str, shared.DEVICE] = "auto"


@dataclass(frozen=True)
class Sensorsim(_Scenes):
    """Render scenes for AlpaSim, and for others that speak its sensorsim service (gRPC).

    The command runs until it is interrupted. It needs the extra alpasim.
    """

    port: int = 50051
    """TCP port; 0 takes a free one."""
    unnamed: Literal["hidden", "logged"] = "hidden"
    """Moving actors that a request does not name: hidden, or logged (at their pose in the log)."""
    world_from_local: Annotated[
        Path | None, shared.option(_WORLD_FROM_LOCAL, "the same coordinates")
    ] = None
    ftheta_centre: float = 0.5
    """Pixels added to the principal point of f-theta cameras. 0.5 counts from the centre of the
    first pixel as NVIDIA's NCore does, 0 from its corner."""
    path: Annotated[
        shared.Names,
        shared.option("Further name of the service, such as a later package. May be repeated."),
    ] = ()
    workers: int = 8
    """Number of threads that read requests and encode images. One at a time draws."""
    queue: int = 256
    """Number of calls that may wait; further ones are refused."""

    def __call__(self) -> None:
        from recast_bridges.serve import ServeRequest, serve_sensorsim

        request = ServeRequest(
            self.scene,
            self.log,
            self.arm,
            self.host,
            self.port,
            self.unnamed,
            self.world_from_local,
            self.ftheta_centre,
            self.path,
            self.workers,
            self.queue,
            self.threads,
            self.device,
        )
        diagnostics.show_warnings()
        serve_sensorsim(request, console_for(False))


@dataclass(frozen=True)
class NeuroNcap(_Scenes):
    """Render scenes for NeuroNCAP's engine (HTTP).

    The command runs until it is interrupted. Each scene has a port of its own.
    """

    port: int = 8000
    """TCP port of the first scene; each further scene has the next one. 0 takes free ones."""
    allow_host: Annotated[shared.Names, shared.ALLOW_HOST] = ()
    world_from_local: Annotated[
        Path | None, shared.option(_WORLD_FROM_LOCAL, "the coordinates of the log's dataset")
    ] = None

    def __call__(self) -> None:
        from recast_bridges.serve import ServeRequest, serve_neuroncap

        request = ServeRequest(
            self.scene,
            self.log,
            self.arm,
            self.host,
            self.port,
            world_from_local=self.world_from_local,
            names=self.allow_host,
            threads=self.threads,
            device=self.device,
        )
        diagnostics.show_warnings()
        serve_neuroncap(request, console_for(False))


Serve = shared.group(
    "serve",
    "Serve other simulators: render trained scenes and runs with replaced vehicles for them "
    "(recast-bridges).",
    {"sensorsim": Sensorsim, "neuroncap": NeuroNcap},
)
