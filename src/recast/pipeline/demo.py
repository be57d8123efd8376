"""`recast demo`: log, scene, actor and rollouts on a synthetic drive with ground truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError
from rich.console import Console

from recast import storage
from recast.actors import DEFAULT_GENERATOR
from recast.pipeline.actor import generator_of
from recast.pipeline.arms import Arm, default_arms
from recast.pipeline.config import RunConfig
from recast.pipeline.drive import drive_log
from recast.pipeline.run import run
from recast.planning import GTRS_MINI, make_planner
from recast.records import validation_error
from recast.scene import SceneConfig
from recast.synthetic import make_world
from recast.synthetic.rendering import require_embree

LOG_FOLDER = "log"
RUN_FOLDER = "run"


@dataclass(frozen=True)
class DemoSize:
    """Size of a demo.

    Attributes:
        seconds: duration of the drive.
        width, height: size of its images in pixels.
        cameras: names of the recorded cameras; empty for all cameras of the rig.
        iterations: training steps of the scene.
        motions: motions of the actor, with their settings.
        steps: steps of 0.1 s of each rollout.
        planner: planner under test unless the caller names another one.
    """

    seconds: float
    width: int
    height: int
    cameras: tuple[str, ...]
    iterations: int
    motions: tuple[str, ...]
    steps: int
    planner: str


FULL = DemoSize(
    8.0, 384, 256, (), 2000, ("cut-in-a", "oncoming-a", "stationary-a"), 50, GTRS_MINI
)  # fmt: skip
# One camera is not enough for a planner that looks.
QUICK = DemoSize(3.0, 192, 128, ("front",), 500, ("cut-in-a",), 20, "idm-follower")


def demo(
    out: str | Path, scene: str, seed: int, size: DemoSize, threads: int, console: Console,
    generator: str = DEFAULT_GENERATOR, planner: str | None = None,
) -> Path:  # fmt: skip
    """Make a drive, reconstruct it, replace the target, and compare rollouts with the truth.

    Args:
        out: folder for `log/`, `run/` and `store/`; results of the same demo there are reused.
        scene: name of a synthetic scene.
        seed: seed of the drive and of all later random choices.
        size: `FULL` or `QUICK`.
        threads: number of CPU threads; 0 uses all cores.
        console: console for steps, progress and the remaining time.
        generator: generator of the vehicle, see `recast.pipeline.actor.generator_of`.
        planner: planner under test, see `recast.planning.make_planner`; None for the planner of
            `size`.

    Returns:
        Path of the report's `index.html`.

    Raises:
        InputError: embreex is missing, or scene, generator or planner is unknown; nothing is
            written then. Or `out` holds other files, or another process works in it.
    """
    require_embree()  # the truth is ray-traced, and so is the log
    world = make_world(scene, seed, size.seconds)
    try:
        config = RunConfig(
            track=world.target,
            motions=size.motions,
            arms=(*default_arms(), Arm.oracle()),
            planners=(planner or size.planner,),
            generator=generator,
            steps=size.steps,
            seed=seed,
            threads=threads,
            scene=SceneConfig(
                scale=1.0,
                iterations=size.iterations,
                seed=seed,
                threads=threads,
            ),
        )
    except ValidationError as error:
        raise validation_error("options", error, "give a value in range") from None
    make_planner(config.planners[0])
    generator_of(config.generator, config.axes)
    out = Path(out)
    with storage.disk_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    with storage.alone_in(out):
        log = drive_log(
            world, out / LOG_FOLDER, (size.width, size.height), size.cameras, threads, console
        )
        return run(log, out / RUN_FOLDER, config, console)
