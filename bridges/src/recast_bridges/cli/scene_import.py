"""`recast scene import` of checkpoints that other programs trained."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from recast.cli import shared
from recast.cli.shared import WORLD_FROM_SCENE, run_import, tell_import

if TYPE_CHECKING:
    from recast.scene.exchange import ImportRecord

LOG_OR_OWN = shared.option("Log folder of the drive that the scene was trained on, or --own-log.")
LEAVE_OUT = shared.several("ACTOR [ACTOR ...]", "optional")
OWN_LOG = shared.option(
    "Log folder to write from the scene's own files, instead of --log; must not exist. It has the "
    "ego, cameras without images, and the actors."
)


def _tracks(actor: str, default: str = "") -> Any:
    """Help of the file that names the log's tracks.

    Args:
        actor: the checkpoint's name of an actor, for the example.
    """
    text = f'JSON file with the log\'s track id of each actor: {{"{actor}": "..."}}.'
    return shared.option(text, default)


def _share(dependent: str) -> Any:
    """Help of the time at which colours that depend on time or view are frozen."""
    return shared.required(
        f"Time at which the {dependent}-dependent colours of an actor are frozen, as a fraction "
        "(0 to 1) of its track."
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
    tracks: Annotated[Path | None, _tracks("obj_003")] = None
    leave_out: Annotated[tuple[str, ...], LEAVE_OUT] = ()
    """Actors to leave out, such as obj_003."""
    share: Annotated[float, _share("time")] = 0.5

    def __call__(self) -> None:
        from recast_bridges.scenes import import_street_gaussians

        run_import(import_street_gaussians, **vars(self))


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
    tracks: Annotated[Path | None, _tracks("0", "the track at the same place")] = None
    leave_out: Annotated[tuple[str, ...], LEAVE_OUT] = ()
    """Numbers of the actors to leave out."""
    share: Annotated[float, _share("view")] = 0.5

    def __call__(self) -> None:
        from recast_bridges.scenes import import_drivestudio

        run_import(import_drivestudio, **vars(self))


@dataclass(frozen=True)
class Mtgs:
    """Import a portable checkpoint of MTGS, such as a published nuPlan scene."""

    checkpoint: tyro.conf.Positional[Path]
    """Folder of the scene, or its checkpoint; code in either is not executed."""
    out: Path
    """Scene folder to write; must not exist."""
    log: Annotated[Path | None, LOG_OR_OWN] = None
    own_log: Annotated[Path | None, OWN_LOG] = None
    tracks: Annotated[
        Path | None, _tracks("TOKEN", "the track of the same name, or at the same place")
    ] = None
    leave_out: Annotated[tuple[str, ...], LEAVE_OUT] = ()
    """Tokens of the actors to leave out."""
    share: Annotated[float, _share("time")] = 0.5

    def __call__(self) -> None:
        from recast_bridges.scenes import import_mtgs, import_mtgs_with_log

        _import_either(import_mtgs, import_mtgs_with_log, **vars(self))


@dataclass(frozen=True)
class Hugsim:
    """Import a scene folder of HUGSIM (scene.pth and the files beside it)."""

    folder: tyro.conf.Positional[Path]
    """Folder of the scene; code in its files is not executed."""
    out: Path
    """Scene folder to write; must not exist."""
    log: Annotated[Path | None, LOG_OR_OWN] = None
    own_log: Annotated[Path | None, OWN_LOG] = None
    camera: Annotated[
        str | None,
        shared.option(
            "Camera of the log that is the scene's front camera.",
            "the one that looks forward most",
            metavar="NAME",
        ),
    ] = None
    first_frame: int = 0
    """Frame of this camera at which the scene begins."""
    time_unit: float = 1.0
    """Seconds of one unit of the scene's times: 0.1 if they are numbers of frames at 10 Hz."""
    world_from_scene: Annotated[Path | None, WORLD_FROM_SCENE] = None
    tracks: Annotated[Path | None, _tracks("12", "the track at the same place")] = None
    leave_out: Annotated[tuple[str, ...], LEAVE_OUT] = ()
    """Names of the actors to leave out: 12 for dynamic_12.pth."""
    share: Annotated[float, _share("view")] = 0.5

    def __call__(self) -> None:
        from recast_bridges.scenes import import_hugsim, import_hugsim_with_log

        _import_either(import_hugsim, import_hugsim_with_log, **vars(self))


def _import_either(
    make: Callable[..., ImportRecord],
    make_with_log: Callable[..., ImportRecord],
    log: Path | None,
    own_log: Path | None,
    out: Path,
    **options: Any,
) -> None:
    """Call an importer with the log that is given, or one that writes the log too."""
    from recast.core.errors import InputError

    if log is not None and own_log is None:
        run_import(make, log=log, out=out, **options)
    elif own_log is not None and log is None:
        tell_import(make_with_log(options.pop(next(iter(options))), own_log, out, **options), out)
    else:
        problem = "exactly one of the two is needed"
        raise InputError("command line", "`log` or `own_log`", problem, "give one of them")
