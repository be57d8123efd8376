"""`recast run`, the whole job from a log to a report; `recast demo`, that of a synthetic drive."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from rich.console import Console

from recast.actors import DEFAULT_GENERATOR, make_generator
from recast.core import Artefact, files, open_store, value_hash
from recast.core.errors import InputError, UnreachableError, printable
from recast.core.plugins import PLANNERS
from recast.core.records import validation_error
from recast.core.workers import usable_cores, use_threads, worker_pool
from recast.metrics import RolloutMetrics, own_metrics, rollout_metrics
from recast.planning import GTRS_MINI, make_planner
from recast.reconstruction import SceneConfig, require_log_of
from recast.reporting.finding import RunFinding
from recast.runs.ahead import Ahead
from recast.runs.arms import Arm, default_arms
from recast.runs.artefacts import Artefacts
from recast.runs.config import RunConfig
from recast.runs.display import failure_lines, results_tables
from recast.runs.report import report_run
from recast.runs.rollouts import announce_planner, read_rollout, require_distinct_planners
from recast.runs.run_folder import (
    LOG_FOLDER,
    METRICS_FILE,
    REPLAY_FILE,
    REPORT_FOLDER,
    RUN_FILE,
    STORE_FOLDER,
    RunFolder,
)
from recast.runs.scores import RunTrust, read_metrics, write_metrics
from recast.runs.sources import RECIPES, SourceLog, Sources, drive_log, require_track
from recast.runs.view import view_inputs
from recast.simulation import (
    MOTIONS,
    RolloutFailure,
    ScriptedMotion,
    Stationary,
    parse_motions,
    prepare,
    scenario_name,
    scenario_record,
)
from recast.simulation.renderer import make_restorer
from recast.synthetic import TARGET, World, check_drive, drive_metadata, make_world
from recast.synthetic.rendering import require_embree
from recast.viewer import require_viser, write_replay

REPLAY_MB = 10.0
"""Size of a run's replay at most, in 1e6 bytes; the report takes a copy, and is passed on whole."""


def run(
    log_path: str | Path,
    out: str | Path,
    config: RunConfig,
    console: Console,
    store: str | Path | None = None,
    world: Callable[[], World] | None = None,
) -> Path:
    """Do the whole job and return the report's `index.html`.

    Args:
        log_path: log folder, or its address in object storage.
        out: run folder; one that holds this run already is resumed.
        store: folder or address of the artefacts; beside `out` where none is named.
        world: gives what a synthetic log was made from, if it is at hand.

    Raises:
        InputError: bad log, track, planner, generator or segmenter, a camera that the planner wants
            and the log lacks, a folder that holds another run, or another process at work there.
    """
    out = Path(out)
    place = str(out.absolute().parent / STORE_FOLDER if store is None else store)
    source = SourceLog.open(log_path, world)
    # What cannot work is refused before anything is written and before minutes of training.
    require_track(source.log, source.path, config.track)
    if config.scene_folder is not None:
        require_log_of(config.scene_folder, source.log)
    if any(arm.needs_world for arm in config.arms):
        source.require_world()
    sources = Sources.of(config, source.log.name)
    artefacts = Artefacts(
        open_store(place), source, config, sources, console, source.log.name, config.threads
    )
    artefacts.require_makeable()
    require_distinct_planners({word: artefacts.planner(word) for word in config.planners})
    for planner in config.planners:
        announce_planner(artefacts.planner(planner), artefacts.mounts(planner), console)
    if config.restorer is not None:
        make_restorer(config.restorer)
    own_metrics(config.metrics)
    for arm in artefacts.arms.values():
        if arm.generates:
            artefacts.makers(arm)
    for line in artefacts.completion.explain():
        console.print(printable(line), markup=False, highlight=False)
    use_threads(config.threads)
    folder = RunFolder.create_or_resume(
        out, config.resolved(), source.address or source.path, source.hash, place
    )
    with files.alone_in(folder.path):
        try:
            return _Run(artefacts, folder, place, console).finish()
        finally:
            artefacts.close()


class _Run:
    def __init__(
        self, artefacts: Artefacts, folder: RunFolder, store: str, console: Console
    ) -> None:
        self._artefacts, self._folder, self._console = artefacts, folder, console
        self._store = store
        self._config = artefacts.config

    def finish(self) -> Path:
        """Make what is not there yet; return the report's page."""
        artefacts = self._artefacts
        artefacts.on_use = lambda: self._folder.refer(artefacts.store, artefacts.used)
        self._announce()
        needed = REPORT_FOLDER not in self._folder.record.finished
        with Ahead(artefacts, self._store, needed) as ahead:
            self._make(ahead)
        self._folder.refer(artefacts.store, artefacts.used, whole=True)
        return self._report()

    def _make(self, ahead: Ahead) -> None:
        """Streets, vehicles and rollouts: each as soon as what it needs is there."""
        artefacts, arms = self._artefacts, list(self._artefacts.arms.values())
        shown = [arm for arm in arms if artefacts.shows(arm)]
        generating = [arm for arm in shown if arm.generates]
        for arm in generating:
            ahead.vehicles(arm)
        for arm in arms:
            if arm not in shown:
                ahead.rollouts(arm)
        for arm in shown:
            artefacts.prepare_street(arm)
        for arm in shown:
            if arm not in generating:
                ahead.rollouts(arm)
        ahead.finish("registered")
        for arm in generating:
            artefacts.prepare(arm, further=False)
            ahead.rollouts(arm)
            ahead.truth(arm)
        for arm in generating:
            artefacts.turntable(arm, self._config.track)
        artefacts.forget_makers()
        for planner in self._config.planners:
            self._agreement(planner)
        ahead.finish("rollout")
        ahead.finish("truth")
        for arm in generating:
            artefacts.prepare(arm)
        for motion, planner, arm in product(self._config.motions, self._config.planners, arms):
            artefacts.rollout(motion, planner, arm)

    def _agreement(self, planner: str) -> None:
        """Compare the planner's plans with those on the recorded images, where that can be done;
        whoever fails here has rollouts that say so."""
        try:
            self._artefacts.agreement(planner)
        except UnreachableError:
            raise
        except Exception as error:
            told = f"{planner} is not compared with the recording: {error}"
            self._console.print(printable(told), markup=False, style="yellow")

    def _report(self) -> Path:
        path, used, source = self._folder.path, self._artefacts.used, self._artefacts.source
        trust = RunTrust(source.log, self._config.track)
        own = "".join(f", {source}" for source in self._artefacts.sources.metrics.values())
        made_from = _hash_of("metrics", used.values()) + own
        self._folder.finish(
            METRICS_FILE,
            made_from,
            lambda: write_metrics(path / METRICS_FILE, self._config, used, source.map, trust),
        )
        made_from = _hash_of("report", used.values()) + own
        made_from += "" if self._replay(made_from) else ", no replay"
        with self._console.status("writing the report"):
            self._folder.finish(REPORT_FOLDER, made_from, lambda: report_run(path))
        metrics = read_metrics(path / METRICS_FILE)
        for table in results_tables(metrics["table"]):
            self._console.print(table)
        for line in failure_lines(metrics["failures"]):
            self._console.print(printable(line), markup=False, highlight=False, style="red")
        found = RunFinding.read(path / REPORT_FOLDER)
        for sentence in () if found is None else found.sentences:
            self._console.print(printable(sentence), markup=False, highlight=False)
        page = path / REPORT_FOLDER / "index.html"
        self._console.print(f"report: {page}", markup=False)
        return page

    def _replay(self, made_from: str) -> bool:
        """Write the moving scene of the first scenario, which the report links."""
        path = self._folder.path

        def write() -> None:
            write_replay(view_inputs([path]), path / REPLAY_FILE, most_mb=REPLAY_MB)

        with self._console.status("writing the replay"):
            try:
                require_viser()
                self._folder.finish(REPLAY_FILE, made_from, write)
            except InputError as error:  # the report says that there is none
                self._console.print(f"no replay: {error}", markup=False, style="yellow")
        return (path / REPLAY_FILE).is_file()

    def _announce(self) -> None:
        """Say before the long steps how far each rollout can go.

        Raises:
            InputError: none of them can be run at all.
        """
        refusals = []
        first = next(iter(self._artefacts.arms.values()))
        for motion in self._config.motions:
            try:
                prepared = prepare(self._artefacts.setup(motion, first))
            except InputError as error:  # becomes a row of the report
                refusals.append(error)
                self._artefacts.possible_steps[motion] = 0
                self._console.print(f"{motion}: refused: {error}", markup=False, style="yellow")
                continue
            self._artefacts.possible_steps[motion] = prepared.steps
            reason = f" ({prepared.cut_reason})" if prepared.cut_reason else ""
            self._console.print(
                f"{motion}: up to {prepared.steps} of {self._config.steps} steps{reason}",
                markup=False,
            )
        if len(refusals) == len(self._config.motions):
            raise refusals[0]


def _hash_of(recipe: str, used: Iterable[Artefact]) -> str:
    references = sorted({artefact.reference for artefact in used})
    return value_hash({"artefacts": references, "recipe": RECIPES[recipe]})


RUN_FOLDER = "run"


@dataclass(frozen=True)
class DemoSize:
    """Size of a demo: seconds of the drive, pixels of its images, steps of 0.1 s of its rollouts.

    Attributes:
        cameras: names of the recorded cameras; empty for all cameras of the rig.
        every: frames of 0.1 s from one that is recorded to the next.
        motions: settings of motions; of each motion one is driven, see `decided`.
    """

    seconds: float
    width: int
    height: int
    cameras: tuple[str, ...]
    iterations: int
    motions: tuple[ScriptedMotion, ...]
    steps: int
    planner: str
    every: int = 1


# So near that what the planner sees decides: 1 m or 4 m beyond where braking with 3.75 m/s2 ends.
_AT_1_M = Stationary("1-m", min_gap=8.0, braking=7.5, reserve=1.0)
_AT_4_M = replace(_AT_1_M, setting="4-m", reserve=4.0)
_MOTIONS = (*parse_motions("cut-in"), *parse_motions("oncoming"), _AT_1_M)
_AHEAD = ("front_left", "front", "front_right")

FULL = DemoSize(8.0, 384, 256, (), 2000, _MOTIONS, 50, GTRS_MINI)
QUICK = DemoSize(5.0, 264, 176, _AHEAD, 400, (_AT_4_M,), 45, GTRS_MINI, every=2)


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
    check_drive(scene, seed, size.seconds)
    world = cache(partial(make_world, scene, seed, size.seconds))
    motions = {scenario_name(motion): motion for motion in size.motions}
    try:
        config = RunConfig(
            track=TARGET,
            motions=tuple(motions),
            own_motions={
                name: scenario_record(m) for name, m in motions.items() if name not in MOTIONS
            },
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
    out = Path(out)
    if not (out / RUN_FOLDER / RUN_FILE).exists():  # else the run looks at them
        make_planner(config.planners[0])
        make_generator(config.generator, config.axes)
    with files.disk_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    with files.alone_in(out):
        pixels = (size.width, size.height)
        log = drive_log(
            world,
            drive_metadata(scene, seed, size.seconds),
            out / LOG_FOLDER,
            pixels,
            size.cameras,
            threads,
            console,
            size.every,
        )
        chosen = _before(out / RUN_FOLDER, config)
        chosen = chosen or decided(log, out / STORE_FOLDER, config, console)
        config = config.model_copy(update={"motions": chosen})
        return run(log, out / RUN_FOLDER, config, console, world=world)


def _before(folder: Path, config: RunConfig) -> tuple[str, ...]:
    """The scenarios that an earlier try of the same demo chose; none without one."""
    if not (folder / RUN_FILE).exists():
        return ()
    earlier = RunFolder.open(folder).config
    everything = {"motions": config.motions, "own_motions": config.own_motions}
    same = earlier.model_copy(update=everything) == config
    return earlier.motions if same else ()


def decided(log: Path, store: Path, config: RunConfig, console: Console) -> tuple[str, ...]:
    """One scenario of each motion, one whose true verdict does not hang on noise.

    Of the settings of a motion, in their order, it is the first in which the truth, undisturbed and
    under each disturbance, always ends in a collision or never does. Where there is none, it is the
    first one that can be driven, and `console` says so. A motion with one setting is not tried.

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
    several = {motion: names for motion, names in settings.items() if len(names) > 1}
    jobs = iter(several.items())
    threads = min(config.threads or usable_cores(), usable_cores())
    workers = min(threads, len(several)) if PLANNERS.is_own(trial.planners[0]) else 1
    given = (log, store, trial.model_dump(mode="json"), console.width)
    chosen = {motion: names[0] for motion, names in settings.items()}
    with console.status("choosing scenarios whose true verdict does not hang on noise"):
        pool = worker_pool(max(workers, 1))
        for (motion, _), (name, told) in pool(
            _start_deciding, given, lambda: next(jobs, None), "finished rollouts"
        ):
            chosen[motion] = name
            console.print(told, markup=False, highlight=False, end="")
    return tuple(chosen.values())


def _start_deciding(
    number: int, log: Path, store: Path, trial: dict[str, Any], width: int
) -> Callable[[tuple[str, Sequence[str]]], tuple[str, str]]:
    """What chooses the setting of one motion, and what it says meanwhile."""
    del number
    config, source = RunConfig.model_validate(trial), SourceLog.open(log)
    name = source.log.name
    sources, opened = Sources.of(config, name), open_store(str(store))

    def decide(settings: tuple[str, Sequence[str]]) -> tuple[str, str]:
        told = io.StringIO()
        console = Console(file=told, width=width, force_terminal=False)
        artefacts = Artefacts(opened, source, config, sources, console, name, oracle_workers=1)
        with closing(artefacts):
            return _decided(settings[1], artefacts, console), told.getvalue()

    return decide


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
        console.print(text, markup=False)
    possible = [setting for setting in settings if setting not in refusals]
    if not possible:
        raise next(iter(refusals.values()))
    console.print(f"{possible[0]} is used anyway", markup=False)
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
        if not _scored(artefacts, setting, planner, arm).same_verdict(truth):
            return arm.noise
    return None


def _scored(artefacts: Artefacts, motion: str, planner: str, arm: Arm) -> RolloutMetrics:
    rollout = read_rollout(artefacts.rollout(motion, planner, arm).path)
    if isinstance(rollout, RolloutFailure):
        raise InputError("planner", planner, f"fails in {motion}: {rollout.reason}", "correct it")
    return rollout_metrics(rollout, artefacts.source.map)
