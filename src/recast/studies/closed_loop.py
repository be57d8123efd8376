"""`recast bench closed-loop`: a whole grid, from scenes to the paper's table; see docs/bench.md."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from recast.actors import make_generator, segmenter_of
from recast.cameras import CameraMount
from recast.core import files
from recast.core.errors import InputError, printable
from recast.core.progress import ProgressBar
from recast.logs import read_log
from recast.planning import BasePlanner, make_planner
from recast.runs.arms import truth_of
from recast.runs.display import failure_lines
from recast.runs.planner_cameras import (
    announce_planner,
    planner_mounts,
    require_distinct_planners,
    run_mounts,
)
from recast.simulation import camera_mount
from recast.simulation.renderer import make_restorer
from recast.studies.grid import RESULTS_FILE, ROLLOUTS_FILE, BenchSettings, begin
from recast.studies.results import (
    GridResults,
    differences_table,
    grid_table,
    results_json,
    summarise,
    times_line,
)
from recast.studies.scene_run import GridTask, RolloutTask, SceneOutcome
from recast.studies.schedule import SceneDesk, Schedule, Times
from recast.studies.verdict_tables import parts_table, truth_table
from recast.studies.verdicts import write_rows
from recast.studies.worker import BenchWorker, Workers
from recast.synthetic import check_drive, world_of
from recast.synthetic.rendering import require_embree
from recast.synthetic.rig import make_rig

_SHOWN_FAILURES = 6


def run_closed_loop(
    settings: BenchSettings,
    out: Path,
    console: Console,
    *,
    workers: int = 1,
    ray: str | None = None,
    retry_failures: bool = False,
    store: str | Path | None = None,
) -> GridResults:
    """Make what is not finished yet, score, compare, write and print it all.

    A scene or rollout that fails is a row with a reason. What a killed grid finished stays; all
    files but the times are the same bytes for any number of workers.

    Args:
        out: folder that is new, empty, or of this very grid.
        retry_failures: run rollouts again that failed in an earlier try.
        store: folder or address of the artefacts; beside `out` where none is named.
        ray: address of a Ray cluster, or None for none. Its machines need share no folder: logs
            and artefacts travel through Ray. Planners, models, vehicles' files and scenes that are
            named by their path must lie on every machine.

    Raises:
        InputError: bad settings, another grid in `out`, or another process at work there, before
            anything is written; or a worker was killed.
    """
    team = Workers(out, workers, ray, store)
    planners = check_grid(settings)
    _require_unshared(planners, workers, ray)
    begin(out, settings.record())
    for planner in planners.values():
        _announce(settings, planner, console)
    names = {word: planner.name for word, planner in planners.items()}
    if ray is not None:
        settings = settings.absolute()
    with files.alone_in(out):  # for its workers, too, which ask for nothing
        results, spent = _make(settings, out, console, team, names, workers, retry_failures)
    _print(results, settings, console)
    console.print(f"time: {times_line(spent)}", markup=False, highlight=False)
    console.print(f"wrote {out}", markup=False)
    return results


def _make(
    settings: BenchSettings,
    out: Path,
    console: Console,
    team: Workers,
    names: Mapping[str, str],
    workers: int,
    retry_failures: bool,
) -> tuple[GridResults, dict[str, Any]]:
    """Make and write everything; return the results and the contents of times.json.

    Args:
        names: planners' names in results, by the word that asks for them.
    """
    desk = SceneDesk(settings, out, team.store, names)
    schedule, times = Schedule(settings, names, desk.score), Times(out, workers)
    began = time.perf_counter()

    def done(task: GridTask, outcome: SceneOutcome) -> None:
        desk.note(task, outcome)
        schedule.note(task, outcome)
        bar(schedule.done, schedule.total)
        if isinstance(task, RolloutTask) and outcome.times is not None:
            times.note(task, outcome.times, time.perf_counter() - began)

    with ProgressBar("scenes and rollouts", console, schedule.total) as bar:
        team.do(BenchWorker, (settings, retry_failures), settings, schedule, done)
    spent = times.write(time.perf_counter() - began, settings, desk.seconds)
    results = summarise(schedule.rows(), settings)
    write_rows(results.rows, out / ROLLOUTS_FILE, truth_of(settings.run.arms))
    files.write_json(out / RESULTS_FILE, results_json(results, settings))
    return results, spent


def check_grid(settings: BenchSettings) -> dict[str, BasePlanner]:
    """Refuse what cannot work before anything is written; return the planners by their words.

    Raises:
        InputError: an arm, a planner or a scene cannot be had.
    """
    config, size = settings.run, settings.drive
    planners = {word: make_planner(word, config.planner_device) for word in config.planners}
    require_distinct_planners(planners)
    if config.restorer is not None:
        make_restorer(config.restorer)
    for scene in settings.scenes:
        for arm in (config.arm(arm.name).of_scene(scene.id) for arm in config.arms):
            if arm.generates:
                make_generator(str(arm.generator), str(arm.axes))
                segmenter_of(str(arm.segmenter))
    synthetic = [scene for scene in settings.scenes if scene.log is None]
    compares = any(arm.needs_world for arm in config.arms)
    if synthetic or compares:
        require_embree()
    for scene in settings.scenes:
        if scene.log is not None and compares:
            world_of(read_log(scene.log))
    if synthetic:
        make_rig(size.width, size.height, config.scene.cameras or None)
    for scene in synthetic:
        check_drive(str(scene.world), scene.seed or 0, size.seconds)
    return planners


def _require_unshared(planners: Mapping[str, BasePlanner], workers: int, ray: str | None) -> None:
    """Refuse several workers of a planner that is one program: they would reset it in turn.

    Raises:
        InputError: names the planner.
    """
    shared = next((word for word, one in planners.items() if one.shared), None)
    if shared is not None and (workers != 1 or ray is not None):
        problem = "is a single program that drives only one rollout at a time"
        raise InputError("`planner`", shared, problem, "use one worker, without `ray`")


def _announce(settings: BenchSettings, planner: BasePlanner, console: Console) -> None:
    """Say what the planner gets to see: in the synthetic scenes, and in each log."""
    config = settings.run
    logs = {scene.id if scene.log else "synthetic": scene.log for scene in settings.scenes}
    for name, log in logs.items():
        try:
            if log is None:
                mounts = planner_mounts(_synthetic_mounts(settings), planner, config)
            else:
                mounts = run_mounts(read_log(log), planner, config)
            announce_planner(planner, mounts, console, f"{name}: ")
        except InputError as error:  # becomes rows of the table
            console.print(f"{name}: {error}", markup=False, style="yellow")


def _synthetic_mounts(settings: BenchSettings) -> dict[str, CameraMount]:
    size, scene = settings.drive, settings.run.scene
    rig = make_rig(size.width, size.height, scene.cameras or None).cameras
    return {n: camera_mount(c.camera, c.rig_from_camera, scene.scale) for n, c in rig.items()}


def _print(results: GridResults, settings: BenchSettings, console: Console) -> None:
    config = settings.run
    for planner in dict.fromkeys(row.planner for row in results.rows):
        title = (
            f"{planner} in closed loop: {len(settings.scenes)} scenes x "
            f"{len(config.motions)} motions and settings, {len(config.arms)} arms"
        )
        table = [line for line in results.table if line.row.planner == planner]
        console.print(grid_table(table, escape(printable(title))))
        differences = [one for one in results.differences if one.planner == planner]
        if differences:
            console.print(differences_table(differences))
        truth = [one for one in results.truth if one.planner == planner]
        if truth:
            console.print(truth_table(truth, results.floors.get(planner)))
        losses = [one for one in results.losses if one.planner == planner]
        if losses:
            console.print(parts_table(losses))
    failed = [
        {
            "name": f"{row.scene} {row.motion}-{row.setting} {row.planner} {row.arm}",
            "reason": str(row.failure_reason).replace(
                f"rollout {row.motion}-{row.setting}-{row.arm}: ", ""
            ),
        }
        for row in results.rows
        if row.failure is not None
    ]
    lines = failure_lines(failed)
    for line in lines[:_SHOWN_FAILURES]:
        console.print(printable(line), markup=False, highlight=False, style="red")
    if len(lines) > _SHOWN_FAILURES:
        more = len(lines) - _SHOWN_FAILURES
        console.print(f"and {more} more reasons in {RESULTS_FILE}", markup=False, style="red")
