"""`recast bench closed-loop`: a whole grid, from scenes to the paper's table; see docs/bench.md."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from recast.actors import make_generator, segmenter_of
from recast.cameras import CameraMount
from recast.core import files
from recast.core.diagnostics import ProgressBar
from recast.core.errors import InputError, printable
from recast.logs import read_log
from recast.metrics import COLUMNS, Column, column_of, columns_of, headlines, own_metrics
from recast.metrics.table import Bootstrap, rounded
from recast.planning import BasePlanner, make_planner
from recast.runs.arms import truth_of
from recast.runs.display import failure_lines, narrow_table
from recast.runs.rollouts import (
    announce_planner,
    planner_mounts,
    require_distinct_planners,
    run_mounts,
)
from recast.simulation import camera_mount
from recast.simulation.renderer import make_restorer
from recast.studies.grid import (
    BENCH_FORMAT,
    BENCH_VERSION,
    RESULTS_FILE,
    ROLLOUTS_FILE,
    ArmSummary,
    BenchSettings,
    GridRow,
    PairedDifference,
    arm_summaries,
    begin,
    paired_summaries,
)
from recast.studies.scene_run import GridTask, RolloutTask, SceneOutcome
from recast.studies.schedule import BenchWorker, SceneDesk, Schedule, Times, Workers
from recast.studies.verdicts import (
    PartLoss,
    VerdictCounts,
    agreements,
    noise_floors,
    part_losses,
    parts_of,
    write_rows,
)
from recast.synthetic import check_drive, world_of
from recast.synthetic.rendering import require_embree
from recast.synthetic.world import make_rig

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
    own_metrics(config.metrics)
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
        ours, *own = headlines(table[0].row.means)
        console.print(grid_table(table, escape(printable(title)), ours))
        for columns in own:
            title = f"own metrics of {planner}"
            console.print(grid_table(table, escape(printable(title)), columns))
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


_BLAME = "nc_at_fault"
_DIGITS = {"s": 2, "%": 1, "": 2}


@dataclass(frozen=True)
class GridResults:
    """What a grid shows.

    Attributes:
        table: a line for each planner and arm.
        truth: a line for each planner and arm that was compared with the truth.
        floors: agreement of the truth with the disturbed truth, by planner; empty without arms of
            noise.
        losses: what each part costs, for each planner; empty without the truth.
    """

    rows: tuple[GridRow, ...]
    table: tuple[ArmSummary, ...]
    differences: tuple[PairedDifference, ...]
    truth: tuple[VerdictCounts, ...]
    floors: Mapping[str, VerdictCounts]
    losses: tuple[PartLoss, ...]


def summarise(rows: Sequence[GridRow], settings: BenchSettings) -> GridResults:
    """The results of all rows; the bootstrap draws by the grid's seed."""
    samples, seed, arms = settings.samples, settings.run.seed, settings.run.arms
    arms = tuple(settings.run.arm(arm.name) for arm in arms)
    truth, noisy = truth_of(arms), [arm.name for arm in arms if arm.is_truth and arm.noise]
    drawn = (samples, seed)
    compared = [] if truth is None else agreements(rows, truth, *drawn)
    floors = [] if truth is None else noise_floors(rows, truth, noisy, *drawn)
    losses = [] if truth is None else part_losses(rows, truth, parts_of(arms), *drawn)
    return GridResults(
        rows=tuple(rows),
        table=tuple(arm_summaries(rows, *drawn)),
        differences=tuple(paired_summaries(rows, arms[0].name, *drawn)),
        truth=tuple(compared),
        floors={one.planner: one for one in floors},
        losses=tuple(losses),
    )


def results_json(results: GridResults, settings: BenchSettings) -> dict[str, Any]:
    """Plain data without times: the same grid gives the same bytes."""
    config = settings.run
    failed = [row for row in results.rows if row.failure is not None]
    return rounded(
        {
            "format": BENCH_FORMAT,
            "version": BENCH_VERSION,
            "planners": list(config.planners),
            "baseline": config.arms[0].name,
            "scenes": [scene.id for scene in settings.scenes],
            "motions": list(config.motions),
            "arms": [arm.name for arm in config.arms],
            "steps": config.steps,
            "rollouts": len(results.rows),
            "failed": len(failed),
            "samples": settings.samples,
            "seed": config.seed,
            "units": {name: column.unit for name, column in columns_of(results.rows).items()},
            "table": [_line(line) for line in results.table],
            "differences": [asdict(one) for one in results.differences],
            "truth": [_agreement(one, results.floors) for one in results.truth],
            "noise_floors": [_agreement(one, {}) for one in results.floors.values()],
            "decomposition": [
                {**asdict(one), "loss": _interval(one.loss)} for one in results.losses
            ],
            "trust": [_trusted(row) for row in results.rows if row.trust is not None],
            "failures": [_failure(row) for row in failed],
        }
    )


def _line(line: ArmSummary) -> dict[str, Any]:
    return {
        **line.row.to_json(),
        "intervals": {name: _interval(one) for name, one in line.intervals.items()},
    }


def _agreement(one: VerdictCounts, floors: Mapping[str, VerdictCounts]) -> dict[str, Any]:
    floor = floors.get(one.planner)
    return {
        **{k: v for k, v in vars(one).items() if not isinstance(v, Bootstrap)},
        "share": _interval(one.share),
        "noise_floor": None if floor is None else floor.share.point,
        "share_of_floor": one.over(floor),
        "ttc_error": None if one.ttc_error is None else _interval(one.ttc_error),
    }


def _interval(one: Bootstrap) -> dict[str, float]:
    return {"mean": one.point, "low": one.low, "high": one.high, "level": one.level}


def _trusted(row: GridRow) -> dict[str, Any]:
    return {**_named(row), **(row.trust or {})}


def _failure(row: GridRow) -> dict[str, Any]:
    return {**_named(row), "error": row.failure, "reason": row.failure_reason}


def _named(row: GridRow) -> dict[str, str]:
    return {name: getattr(row, name) for name in ("scene", "motion", "setting", "planner", "arm")}


def grid_table(
    lines: Sequence[ArmSummary], title: str, columns: Mapping[str, Column] = COLUMNS
) -> Table:
    """A line for each arm: means with their intervals over scenes.

    Below the names stands how many rollouts were scored, of how many. A metric that not every one
    of them has says over how many it is. Below NC stands how many collisions the ego is to blame
    for.

    Args:
        columns: metrics, of which the headlines are shown.
    """
    headline = {name: column for name, column in columns.items() if column.headline}
    table = narrow_table(title, ["arm"], [column.heading for column in headline.values()])
    for line in lines:
        row = line.row
        told = [broken_name(row.arm), f"{row.rollouts} of {row.asked}", f"{row.plans} plans"]
        told += [f"{n} {what}" for n, what in ((row.failed, "failed"), (row.cut, "cut")) if n]
        table.add_row("\n".join(told), *(_mean(line, name) for name in headline))
    return table


def differences_table(differences: Sequence[PairedDifference]) -> Table:
    """A line for each headline metric of each arm: its difference from the first arm."""
    level = 100 * differences[0].sampled.level
    scenes = max(one.scenes for one in differences)
    baseline = f"minus\n{broken_name(differences[0].baseline)}"
    title = f"paired differences, bootstrap over {scenes} scenes"
    figures = ["mean", f"{level:g} % sampled", "exact", "pairs", "plans"]
    table = narrow_table(title, [baseline, "metric"], figures)
    for one in differences:
        column = column_of(one.metric)
        if not column.headline:
            continue
        digits = _DIGITS[column.unit]
        table.add_row(
            broken_name(one.candidate),
            f"{column.label} {column.unit}",
            f"{one.sampled.point:+.{digits}f}",
            _signed(one.sampled, digits),
            "n/a" if one.exact is None else _signed(one.exact, digits),
            pairs_told(one),
            str(one.plans),
        )
    return table


def times_line(times: Mapping[str, Any]) -> str:
    """Where the time went, in one line."""
    whole, session = times["all"], times["sessions"][-1]
    shares = ", ".join(
        f"{name} {100 * share:.0f} %"
        for name, share in whole["shares"].items()
        if share is not None
    )
    return (
        f"{session['seconds']:.0f} s with --workers {session['workers']} for "
        f"{session['rollouts']} rollouts; in total {whole['rollouts']} in {whole['seconds']:.0f} s"
        + (f": {shares}" if shares else "")
    )


def broken_name(arm: str) -> str:
    """The name of an arm as narrow columns break it."""
    return arm.replace("+", "+\n").replace(":", ":\n")


def _mean(line: ArmSummary, name: str) -> str:
    mean, digits = line.row.means[name], _DIGITS[column_of(name).unit]
    if mean is None:
        return "n/a"
    shown = [f"{mean:.{digits}f}", span(line.intervals[name], digits)]
    count = line.row.counts[name]
    if column_of(name).passes:
        shown.insert(1, f"{round(mean * count / 100)}/{count}")
        blame = line.row.means.get(_BLAME) if name == "nc" else None
        if blame is not None and mean < 100.0:
            shown.append(f"{round((1.0 - blame / 100.0) * count)} at fault")
    elif count < line.row.rollouts:
        shown.insert(1, f"of {count}")
    return "\n".join(shown)


def pairs_told(one: PairedDifference | VerdictCounts) -> str:
    """How many of how many, and how many of them end where one of the two was cut."""
    pairs = f"{one.pairs}/{one.asked}"
    return f"{pairs}\n{one.cut} cut" if one.cut else pairs


def span(one: Bootstrap, digits: int) -> str:
    """An interval without its mean."""
    return f"{one.low:.{digits}f}-{one.high:.{digits}f}".replace("100.0", "100")


def _signed(one: Bootstrap, digits: int) -> str:
    return f"[{one.low:+.{digits}f}, {one.high:+.{digits}f}]".replace("100.0", "100")


def truth_table(lines: Sequence[VerdictCounts], floor: VerdictCounts | None = None) -> Table:
    """A line for each arm: whether its rollouts end as the truth's do.

    False are collisions that the truth's rollouts do not have, missed are those that they have.

    Args:
        floor: the agreement of the same planner with the disturbed truth.
    """
    beside = [] if floor is None else ["noise\nfloor", "agreement\n/ floor"]
    figures = ["agreement", *beside, "false,\nmissed", "TTC\nerror s", "pairs", "plans"]
    table = narrow_table("against the truth", ["arm"], figures)
    for one in lines:
        ratio = one.over(floor)
        floors = (
            [] if floor is None else [_share(floor), "n/a" if ratio is None else f"{ratio:.2f}"]
        )
        error = one.ttc_error
        table.add_row(
            broken_name(one.arm),
            _share(one),
            *floors,
            f"{one.false_collisions}, {one.missed_collisions}",
            "n/a" if error is None else f"{error.point:.3f}\n{span(error, 3)}",
            pairs_told(one),
            str(one.plans),
        )
    return table


def parts_table(losses: Sequence[PartLoss]) -> Table:
    """A line for each pair of arms that differ in one part: agreement of both, and the loss."""
    figures = ["agree", "of", "lost %", "95 % interval"]
    table = narrow_table("causes of disagreement", ["arm", "part", "without"], figures)
    for one in losses:
        loss = _percent(one.loss)
        table.add_row(
            broken_name(one.arm),
            one.part,
            broken_name(one.other),
            f"{one.agreeing}, {one.other_agreeing}",
            str(one.pairs),
            f"{loss.point:+.1f}",
            f"[{loss.low:+.1f}, {loss.high:+.1f}]",
        )
    return table


def _share(one: VerdictCounts) -> str:
    """How many agree of how many, in percent, and its interval."""
    share = _percent(one.share)
    return f"{one.agreeing}/{one.pairs}\n{share.point:.1f} %\n{span(share, 1)}"


def _percent(one: Bootstrap) -> Bootstrap:
    return replace(one, point=100 * one.point, low=100 * one.low, high=100 * one.high)
