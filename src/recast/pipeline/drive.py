"""The log of a synthetic drive, made where it is not there yet."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from recast.errors import InputError
from recast.logs import DrivingLog, read_log
from recast.pipeline.display import FrameProgress
from recast.synthetic import CAMERAS, World, synthesize_log, world_metadata


def drive_log(
    world: World,
    path: Path,
    image_size: tuple[int, int],
    cameras: tuple[str, ...],
    workers: int,
    console: Console,
) -> Path:
    """The log of `world` at `path`.

    Args:
        image_size: width and height, pixels.
        cameras: that are recorded; none named: all of the rig.
        workers: processes, see `synthesize_log`.
        console: shows progress.

    Raises:
        InputError: another log lies there, or see `synthesize_log`.
    """
    console.print(f"[bold]log[/bold] {world.name}, {world.seconds:g} s", highlight=False)
    names = cameras or CAMERAS
    if path.exists():
        _check_same(read_log(path), world, image_size, names, path)
        console.print("  finished before")
        return path
    width, height = image_size
    with FrameProgress(console, round(world.seconds * 10) * len(names), "images") as progress:
        synthesize_log(
            world, path, width=width, height=height, cameras=names, workers=workers,
            progress=progress.reach,
        )  # fmt: skip
    return path


def _check_same(
    log: DrivingLog, world: World, image_size: tuple[int, int], names: tuple[str, ...], path: Path
) -> None:
    shape = {name: (c.camera.width, c.camera.height) for name, c in log.cameras.items()}
    wanted = world_metadata(world)
    same = {name: log.metadata.get(name) for name in wanted} == wanted
    if not same or shape != dict.fromkeys(names, image_size):
        raise InputError(
            path, "log", "is that of another drive", "name another --out, or remove this one"
        )
