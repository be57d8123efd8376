"""A training run: which configuration and log its folder belongs to, and what it tells."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import ValidationError
from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn
from rich.text import Text

from recast.core.errors import InputError
from recast.core.files import partial_name, read_json, write_json
from recast.core.records import Record
from recast.logs import DrivingLog
from recast.scene.config import SceneConfig, parse_config, write_config

CONFIG_FILE = "config.json"
SOURCE_FILE = "source.json"
FREE_FIELDS = frozenset({"threads", "evaluate_every", "checkpoint_every"})
"""Fields that may differ when a run is taken up again: they do not change what is learned."""


class TrainingSource(Record):
    """Contents of source.json: the log a scene is made from."""

    log_name: str
    log_fingerprint: str


def log_fingerprint(log: DrivingLog) -> str:
    """SHA-256 over everything of a log but images and points, in hexadecimal.

    Times, poses, intrinsics and boxes tell drives and imports apart; hashing all pixels would take
    longer than starting over.
    """
    digest = hashlib.sha256(log.name.encode())

    def add(name: str, *arrays: object) -> None:
        digest.update(name.encode())
        for array in arrays:
            digest.update(np.ascontiguousarray(array).tobytes())

    add("ego", log.world_from_rig.timestamps_us, log.world_from_rig.poses, log.world_offset)
    for name, camera in log.cameras.items():
        intrinsics = camera.camera
        add(name, camera.timestamps_us, camera.rig_from_camera, intrinsics.matrix)
        add("image", [intrinsics.width, intrinsics.height], intrinsics.distortion)
    for name, lidar in log.lidars.items():
        add(name, lidar.timestamps_us, lidar.rig_from_lidar)
    for name, track in log.tracks.items():
        add(name, track.size, track.trajectory.timestamps_us, track.trajectory.poses)
    return digest.hexdigest()


def claim_folder(folder: Path, log: DrivingLog, config: SceneConfig) -> None:
    """Make `folder` this run's, or check that it is already.

    Raises:
        InputError: it holds something else, or a run with another log, configuration or version.
    """
    source = TrainingSource(log_name=log.name, log_fingerprint=log_fingerprint(log))
    if folder.exists() and not folder.is_dir():
        raise InputError(folder, "output folder", "is a file", "name another folder")
    if (folder / CONFIG_FILE).is_file() and (folder / SOURCE_FILE).is_file():
        _check_same(folder, source, config)
        return
    strangers = [] if not folder.exists() else sorted(folder.iterdir())
    begun = {
        partial_name(name).name for name in (CONFIG_FILE, SOURCE_FILE)
    }  # left behind by a kill
    ours = {CONFIG_FILE, SOURCE_FILE, *begun}
    strangers = [path for path in strangers if path.name not in ours]
    if strangers:
        raise InputError(
            folder,
            "output folder",
            f"holds something that is not a scene ({strangers[0].name})",
            "name another folder or remove this one",
        )
    write_json(folder / SOURCE_FILE, source.model_dump())
    write_config(config, folder / CONFIG_FILE)


def read_training_config(folder: str | Path) -> SceneConfig:
    """The configuration that a scene folder was trained with.

    Raises:
        InputError: missing, broken or of another version.
    """
    path = Path(folder) / CONFIG_FILE
    return parse_config(path, read_json(path))


def _check_same(folder: Path, source: TrainingSource, config: SceneConfig) -> None:
    mend = "name another folder or remove this one"
    found = read_training_config(folder)
    if not found.is_whole():
        problem = "were written by an earlier release with another recipe"
        raise InputError(folder / CONFIG_FILE, "fields", problem, mend)
    for name in SceneConfig.model_fields:
        before, asked = getattr(found, name), getattr(config, name)
        if name not in FREE_FIELDS and before != asked:
            raise InputError(
                folder, name, f"holds a run with {before!r}, this one has {asked!r}", mend
            )
    try:
        before = TrainingSource.model_validate(read_json(folder / SOURCE_FILE))
    except ValidationError:
        raise InputError(folder / SOURCE_FILE, "source", "cannot be read", mend) from None
    if before != source:
        raise InputError(
            folder,
            "log",
            f"holds a run of {before.log_name}"
            + (" in another state" if before.log_name == source.log_name else ""),
            mend,
        )


@dataclass(frozen=True)
class TrainingStatus:
    """A moment of a training run.

    Attributes:
        phase: what is being done: "initialise", "train", "evaluate", "done".
        iteration, iterations: steps done, and of how many.
        gaussians: number of Gaussians.
        most_gaussians: limit of Gaussians; None before it is known.
        limited: whether the limit kept any from being added.
        loss, psnr: running means over the latest training views; None before the first.
        held_out_psnr: PSNR of the last periodic evaluation in dB; None before the first.
        iterations_per_second: rate over the latest steps.
        seconds_left: estimate to the end of training.
    """

    phase: str
    iteration: int
    iterations: int
    gaussians: int = 0
    most_gaussians: int | None = None
    limited: bool = False
    loss: float | None = None
    psnr: float | None = None
    held_out_psnr: float | None = None
    iterations_per_second: float | None = None
    seconds_left: float | None = None


ProgressCallback = Callable[[TrainingStatus], None]


class TrainingDisplay(Progress):
    """A live bar with a line of figures; pass the object itself as `progress` to `train_scene`.

    >>> from recast.scene import train_scene
    >>> with TrainingDisplay() as display:                      # doctest: +SKIP
    ...     train_scene(log, out, config, progress=display)
    """

    def __init__(self, console: Console | None = None) -> None:
        columns = BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
        self._figures = Text()
        super().__init__("{task.description}", *columns, console=console, refresh_per_second=4)
        self._task = self.add_task("scene", total=None)

    def __call__(self, status: TrainingStatus) -> None:
        """Show a status."""
        self._figures = Text("  " + describe(status), style="dim")
        self.update(
            self._task,
            description=f"scene: {status.phase}",
            total=status.iterations,
            completed=status.iteration,
        )

    def get_renderables(self) -> Iterator[RenderableType]:
        """The bar, and the figures below it."""
        yield from super().get_renderables()
        yield self._figures


def describe(status: TrainingStatus) -> str:
    """One line of figures: those that are known."""
    parts = [f"{status.gaussians:,} Gaussians"] if status.gaussians else []
    if status.limited:
        parts.append(f"limit of {status.most_gaussians:,} met")
    if status.loss is not None:
        parts.append(f"loss {status.loss:.4f}")
    if status.psnr is not None:
        parts.append(f"train {status.psnr:.2f} dB")
    if status.held_out_psnr is not None:
        parts.append(f"held out {status.held_out_psnr:.2f} dB")
    if status.iterations_per_second is not None:
        parts.append(f"{status.iterations_per_second:.1f} it/s")
    if status.seconds_left is not None:
        minutes, seconds = divmod(round(status.seconds_left), 60)
        parts.append(f"{minutes}:{seconds:02d} left")
    return ", ".join(parts)
