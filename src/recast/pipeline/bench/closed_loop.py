"""`recast bench closed-loop`: the whole grid, from scenes to the paper's table.

OUT/bench.json         what the grid is
OUT/scenes/ID/log      a synthetic scene's log
OUT/scenes/ID/run      an ordinary run (docs/runs.md)
OUT/rollouts.parquet   one row a rollout (docs/bench.md)
OUT/results.json       tables, paired differences, agreement with the truth
OUT/times.json         where the time went
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from recast import storage
from recast.actors import segmenter_of
from recast.crews import Crew, crew_of
from recast.errors import InputError, printable
from recast.evaluation.grid_file import write_rows
from recast.logs import read_log
from recast.pipeline.actor import generator_of
from recast.pipeline.bench.display import differences_table, grid_table, times_line, truth_table
from recast.pipeline.bench.results import GridResults, results_json, summarise
from recast.pipeline.bench.schedule import Schedule
from recast.pipeline.bench.settings import RESULTS_FILE, ROLLOUTS_FILE, BenchSettings, begin
from recast.pipeline.bench.tasks import RolloutTask
from recast.pipeline.bench.times import Times
from recast.pipeline.bench.worker import start_worker
from recast.pipeline.display import FrameProgress
from recast.pipeline.planner import announce_planner, planner_mounts, run_mounts
from recast.planning import CameraMount, Planner, make_planner
from recast.simulation import camera_mount
from recast.synthetic import check_drive, world_of
from recast.synthetic.rendering import require_embree
from recast.synthetic.rig import make_rig

_FINISHED = "finished rollouts"
_SHOWN_FAILURES = 6


def run_closed_loop(
    settings: BenchSettings,
    out: Path,
    console: Console,
    *,
    workers: int = 1,
    ray: str | None = None,
    retry_failures: bool = False,
) -> GridResults:
    """Make what is not finished yet, score, compare, write and print it all.

    A scene or rollout that fails is a row with a reason. What a killed grid finished stays; all
    files but the times are the same bytes for any number of workers.

    Args:
        settings: of the grid.
        out: new, empty, or of this very grid.
        console: shows progress and tables.
        workers: processes of this machine, or actors of the cluster.
        ray: address of a Ray cluster that shares this file system, or None for none.
        retry_failures: run rollouts again that failed in an earlier try.

    Raises:
        InputError: bad settings, another grid in `out`, or another process at work there, before
            anything is written; or a worker was killed.
    """
    crew = crew_of(workers, ray)
    planner = _check(settings)
    begin(out, settings)
    _announce(settings, planner, console)
    if ray is not None:  # its workers have another working folder
        logs = (scene.log for scene in settings.scenes)
        scenes = tuple(
            replace(scene, log=None if log is None else log.absolute())
            for scene, log in zip(settings.scenes, logs, strict=True)
        )
        settings, out = replace(settings, scenes=scenes), out.absolute()
    with storage.alone_in(out):  # for its workers, too, which ask for nothing
        results, spent = _make(settings, out, console, crew, planner.name, workers, retry_failures)
    _print(results, settings, console)
    console.print(f"time: {times_line(spent)}", markup=False, highlight=False)
    console.print(f"wrote {out}", markup=False)
    return results


def _make(
    settings: BenchSettings,
    out: Path,
    console: Console,
    crew: Crew,
    planner: str,
    workers: int,
    retry_failures: bool,
) -> tuple[GridResults, dict[str, Any]]:
    """Make and write everything; return the results and the contents of times.json."""
    schedule, times = Schedule(settings, planner), Times(out, workers)
    began = time.perf_counter()
    arguments = (out, settings, retry_failures)
    with FrameProgress(console, schedule.total, "scenes and rollouts") as bar:
        for task, outcome in crew(start_worker, arguments, schedule.take, _FINISHED):
            schedule.note(task, outcome)
            bar.reach(schedule.done, schedule.total)
            if isinstance(task, RolloutTask) and outcome.times is not None:
                times.note(task, outcome.times, time.perf_counter() - began)
    spent = times.write(time.perf_counter() - began, settings)
    results = summarise(schedule.rows(), settings)
    write_rows(results.rows, out / ROLLOUTS_FILE)
    storage.write_json(out / RESULTS_FILE, results_json(results, settings))
    return results, spent


def _check(settings: BenchSettings) -> Planner:
    """Refuse what cannot work before anything is written; return the planner."""
    config, size = settings.run, settings.drive
    planner = make_planner(config.planner, config.planner_device)
    generator_of(config.generator, config.axes)
    segmenter_of(config.segmenter)
    synthetic = [scene for scene in settings.scenes if scene.log is None]
    if synthetic or "oracle" in config.methods:
        require_embree()
    for scene in settings.scenes:
        if scene.log is not None and "oracle" in config.methods:
            world_of(read_log(scene.log))
    if synthetic:
        make_rig(size.width, size.height, config.scene.cameras or None)
    for scene in synthetic:
        check_drive(str(scene.world), scene.seed or 0, size.seconds)
    return planner


def _announce(settings: BenchSettings, planner: Planner, console: Console) -> None:
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
    title = (
        f"{config.planner} in closed loop: {len(settings.scenes)} scenes x "
        f"{len(config.motions)} motions and settings, {len(config.methods)} methods"
    )
    console.print(grid_table(results.table, escape(printable(title))))
    if results.differences:
        console.print(differences_table(results.differences))
    if results.truth:
        console.print(truth_table(results.truth))
    failed = [row for row in results.rows if row.failure is not None]
    for row in failed[:_SHOWN_FAILURES]:
        where = f"{row.scene} {row.motion}-{row.setting} {row.method}"
        console.print(printable(f"{where}: {row.failure_reason}"), markup=False, style="red")
    if len(failed) > _SHOWN_FAILURES:
        more = len(failed) - _SHOWN_FAILURES
        console.print(f"and {more} more failures, see {RESULTS_FILE}", markup=False, style="red")
