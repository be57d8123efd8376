"""`recast demo`: the whole way on a made-up drive, for which the truth is known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from recast.actors import DEFAULT_GENERATOR
from recast.errors import InputError
from recast.logs import DrivingLog, read_log
from recast.pipeline.config import RunConfig
from recast.pipeline.display import FrameProgress
from recast.pipeline.layout import METHODS
from recast.pipeline.run import run
from recast.scene import SceneConfig
from recast.synthetic import (
    CAMERAS,
    World,
    make_world,
    synthesize_log,
    world_metadata,
)

LOG_FOLDER = "log"
RUN_FOLDER = "run"


@dataclass(frozen=True)
class DemoSize:
    """How much of everything.

    Attributes:
        seconds: of the drive.
        width, height: of its images, pixels.
        cameras: that are recorded; none named: all of the rig.
        iterations: training steps of the scene.
        motions: of the actor, with their settings.
        steps: of 0.1 s, a rollout.
    """

    seconds: float
    width: int
    height: int
    cameras: tuple[str, ...]
    iterations: int
    motions: tuple[str, ...]
    steps: int


FULL = DemoSize(
    8.0, 384, 256, (), 2000, ("cut-in-a", "oncoming-a", "stationary-a"), steps=50
)  # fmt: skip
QUICK = DemoSize(3.0, 192, 128, ("front",), 500, ("cut-in-a",), steps=20)


def demo(
    out: str | Path, scene: str, seed: int, size: DemoSize, threads: int, console: Console,
    generator: str = DEFAULT_GENERATOR,
) -> Path:  # fmt: skip
    """Make a drive, reconstruct it, replace the target, and run it against the truth.

    Args:
        out: gets `log/` and `run/`; what lies there of the same demo is used again.
        scene: name of a synthetic scene.
        seed: of the scene and of everything after.
        size: `FULL` or `QUICK`.
        threads: CPU threads, 0 for all.
        console: shows steps, progress and time left.
        generator: what makes the vehicle, see `recast.pipeline.actor.generator_of`.

    Returns:
        the report's `index.html`.

    Raises:
        InputError: unknown scene, or `out` holds something else.
    """
    if threads < 0:
        raise InputError("threads", str(threads), "is negative", "choose 0 for all cores")
    world = make_world(scene, seed, size.seconds)
    log = _drive(world, Path(out) / LOG_FOLDER, size, threads, console)
    config = RunConfig(
        track=world.target,
        motions=size.motions,
        methods=tuple(METHODS),
        generator=generator,
        steps=size.steps,
        seed=seed,
        threads=threads,
        scene=SceneConfig(
            scale=1.0,
            iterations=size.iterations,
            seed=seed,
            threads=threads,
            force_dynamic=(world.target,),
        ),
    )
    return run(log, Path(out) / RUN_FOLDER, config, console)


def _drive(world: World, path: Path, size: DemoSize, threads: int, console: Console) -> Path:
    """The log at `path`, made where it is not there yet."""
    console.print(f"[bold]log[/bold] {world.name}, {world.seconds:g} s", highlight=False)
    if path.exists():
        _check_same(read_log(path), world, size, path)
        console.print("  finished before")
        return path
    names = size.cameras or None
    frames = round(size.seconds * 10) * len(size.cameras or CAMERAS)
    with FrameProgress(console, frames, "images") as progress:
        synthesize_log(
            world, path, width=size.width, height=size.height, cameras=names, workers=threads,
            progress=progress.reach,
        )  # fmt: skip
    return path


def _check_same(log: DrivingLog, world: World, size: DemoSize, path: Path) -> None:
    shape = {name: (c.camera.width, c.camera.height) for name, c in log.cameras.items()}
    wanted = world_metadata(world)
    same = {name: log.metadata.get(name) for name in wanted} == wanted
    if not same or shape != dict.fromkeys(size.cameras or CAMERAS, (size.width, size.height)):
        raise InputError(
            path, "log", "is that of another demo", "name another --out, or remove this one"
        )
