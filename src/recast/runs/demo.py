"""`recast demo`: a synthetic drive from log to report, in scenarios that noise does not decide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError
from rich.console import Console

from recast.actors import DEFAULT_GENERATOR, make_generator
from recast.core import files, open_store
from recast.core.errors import InputError
from recast.core.records import validation_error
from recast.core.workers import use_threads
from recast.metrics import RolloutMetrics, rollout_metrics
from recast.metrics.table import over_common_steps
from recast.planning import GTRS_MINI, make_planner
from recast.reconstruction import SceneConfig
from recast.runs.arms import Arm, default_arms
from recast.runs.artefacts import Artefacts
from recast.runs.config import RunConfig
from recast.runs.rollouts import read_rollout
from recast.runs.run import run
from recast.runs.run_folder import LOG_FOLDER, STORE_FOLDER
from recast.runs.sources import SourceLog, Sources, drive_log
from recast.simulation import RolloutFailure, parse_motions, prepare, scenario_name
from recast.synthetic import make_world
from recast.synthetic.rendering import require_embree

RUN_FOLDER = "run"


@dataclass(frozen=True)
class DemoSize:
    """Size of a demo: seconds of the drive, pixels of its images, steps of 0.1 s of its rollouts.

    Attributes:
        cameras: names of the recorded cameras; empty for all cameras of the rig.
        motions: each is driven in one setting, see `decided`.
    """

    seconds: float
    width: int
    height: int
    cameras: tuple[str, ...]
    iterations: int
    motions: tuple[str, ...]
    steps: int
    planner: str


FULL = DemoSize(8.0, 384, 256, (), 2000, ("cut-in", "oncoming", "stationary"), 50, GTRS_MINI)
# One camera is not enough for a planner that looks.
QUICK = DemoSize(3.0, 192, 128, ("front",), 500, ("cut-in",), 20, "idm-follower")


def demo(
    out: str | Path,
    scene: str,
    seed: int,
    size: DemoSize,
    threads: int,
    console: Console,
    generator: str = DEFAULT_GENERATOR,
    planner: str | None = None,
) -> Path:
    """Make a drive, reconstruct it, replace the target, and compare rollouts with the truth.

    Args:
        out: folder for `log/`, `run/` and `store/`; results of the same demo there are reused.
        scene, size: name of a synthetic scene; `FULL` or `QUICK`.
        seed: seed of the drive and of all later random choices.
        threads: CPU threads, 0 for all cores.
        generator, planner: see `recast.actors.make_generator`, `recast.planning.make_planner`;
            None for the planner of `size`.

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
            motions=tuple(scenario_name(m) for name in size.motions for m in parse_motions(name)),
            arms=(*default_arms(), Arm.oracle()),
            planners=(planner or size.planner,),
            generator=generator,
            steps=size.steps,
            seed=seed,
            threads=threads,
            scene=SceneConfig(scale=1.0, iterations=size.iterations, seed=seed, threads=threads),
        )
    except ValidationError as error:
        raise validation_error("options", error, "give a value in range") from None
    make_planner(config.planners[0])
    make_generator(config.generator, config.axes)
    out = Path(out)
    with files.disk_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    with files.alone_in(out):
        log = drive_log(
            world, out / LOG_FOLDER, (size.width, size.height), size.cameras, threads, console
        )
        motions = decided(log, out / STORE_FOLDER, config, console)
        return run(log, out / RUN_FOLDER, config.model_copy(update={"motions": motions}), console)


def decided(log: Path, store: Path, config: RunConfig, console: Console) -> tuple[str, ...]:
    """One scenario of each motion, one whose true verdict does not hang on noise.

    Of the settings of a motion, in their order, it is the first in which the truth, undisturbed and
    under each disturbance, always ends in a collision or never does. Where there is none, it is the
    first one that can be driven, and `console` says so.

    Args:
        log: log folder of a synthetic drive.
        config: its scenarios are the settings to choose from; its first planner drives.

    Raises:
        InputError: no setting of a motion can be driven.
    """
    settings: dict[str, list[str]] = {}
    for name in config.motions:
        settings.setdefault(config.motion(name).name, []).append(name)
    truth = Arm.oracle()
    arms = (truth, *map(truth.disturbed, truth.noises))
    trial = config.model_copy(update={"arms": arms, "films": False})
    source = SourceLog.open(log)
    name = source.log.name
    sources = Sources.of(trial, name)
    opened = open_store(str(store))
    artefacts = Artefacts(opened, source, trial, sources, console, name, config.threads)
    use_threads(config.threads)
    try:
        return tuple(_decided(names, artefacts, console) for names in settings.values())
    finally:
        artefacts.close()


def _decided(settings: Sequence[str], artefacts: Artefacts, console: Console) -> str:
    """The setting of one motion, see `decided`."""
    refusals: dict[str, InputError] = {}
    for setting in settings:
        try:
            flipping = _flipping(setting, artefacts)
        except InputError as error:  # the drive is too short for it, or the road is
            refusals[setting] = error
            continue
        if flipping is None:
            return setting
        text = f"{setting}: the noise {flipping!r} changes the verdict of the truth"
        console.print(text, markup=False, style="yellow")
    possible = [setting for setting in settings if setting not in refusals]
    if not possible:
        raise next(iter(refusals.values()))
    console.print(f"{possible[0]} is used anyway", markup=False, style="yellow")
    return possible[0]


def _flipping(setting: str, artefacts: Artefacts) -> str | None:
    """The first noise under which the truth ends otherwise.

    Raises:
        InputError: the scenario cannot be driven.
    """
    planner = artefacts.config.planners[0]
    true, *noisy = artefacts.arms.values()
    prepare(artefacts.setup(setting, true))
    truth = _scored(artefacts, setting, planner, true)
    for arm in noisy:
        one, other = over_common_steps(_scored(artefacts, setting, planner, arm), truth)
        if one.collision.nc.value != other.collision.nc.value:
            return arm.noise
    return None


def _scored(artefacts: Artefacts, motion: str, planner: str, arm: Arm) -> RolloutMetrics:
    rollout = read_rollout(artefacts.rollout(motion, planner, arm).path)
    if isinstance(rollout, RolloutFailure):
        raise InputError("planner", planner, f"fails in {motion}: {rollout.reason}", "correct it")
    return rollout_metrics(rollout, artefacts.source.map)
