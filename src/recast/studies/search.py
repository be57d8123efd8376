"""`recast search`: where in a range of settings a planner begins to fail; see docs/search.md.

A *line* of a study is one log, motion, planner and arm: its trials are proposed by a `Design` from
what came of the earlier ones, batch by batch. They are kept in a database, on which several
processes and machines may work; the rollouts themselves are artefacts of the store.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

from rich.console import Console

from recast.core import files, value_hash
from recast.core.diagnostics import ProgressBar
from recast.core.errors import InputError
from recast.core.plugins import METRICS
from recast.metrics import own_metrics, rollout_metrics
from recast.runs.rollouts import read_rollout
from recast.simulation import ScriptedMotion, motion, motion_of_record, scenario_name
from recast.simulation.rollout import Rollout
from recast.simulation.scenario import (
    MOTION_SCHEMAS,
    kind_of,
    motion_numbers,
    scenario_record,
    target_motion,
)
from recast.studies.closed_loop import check_grid
from recast.studies.designs import Axis, Design, Point, parse_axis
from recast.studies.grid import BenchSettings, begin
from recast.studies.scene_run import (
    GridTask,
    RolloutTask,
    RolloutTimes,
    SceneOutcome,
    SceneRun,
    SceneTask,
)
from recast.studies.schedule import BenchWorker, Workers
from recast.studies.study_database import SearchLine, StudyDatabase, Trial
from recast.studies.trials import Objective, difficulty, measured, parse_objective

SEARCH_FORMAT, SEARCH_VERSION = "recast-search", 1
RECORD_FILE, DATABASE_FILE = "search.json", "search.db"
SEED = "seed"
"""What an axis is named that is no setting: seeds of planners that sample, and of motions."""
_POLL = 1.0  # seconds between looks at what other processes do


@dataclass(frozen=True)
class SearchSettings:
    """A search.

    Attributes:
        bench: logs, arms, planners and all else that is the same for every trial; its motions are
            those that are varied.
        fixed: values of settings that differ from the motions' own.
        design: which points are tried.
        objective: what counts as a failure.
    """

    bench: BenchSettings
    design: Design
    objective: Objective
    fixed: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        twice = next((axis.name for axis in self.design.axes if axis.name in self.fixed), None)
        if twice is not None:
            raise InputError("`set`", twice, "is varied, too", "leave it out, or leave out `over`")
        if any(axis.name == SEED and not axis.choices for axis in self.design.axes):
            raise InputError("`over`", SEED, "has no range", "give the seeds: seed=0,1,2")
        for name in self.bench.run.motions:
            for point in _corners(self.design.axes):
                self.scenario(name, point)
        units = {key: unit for name in self.bench.run.motions for key, unit in self._units(name)}
        units[SEED] = ""
        axes = tuple(replace(axis, unit=units[axis.name]) for axis in self.design.axes)
        object.__setattr__(self, "design", replace(self.design, axes=axes))

    def _units(self, name: str) -> list[tuple[str, str]]:
        kind = kind_of(target_motion(self.bench.run.motion(name)))
        known = {} if kind is None else MOTION_SCHEMAS[kind].quantities
        return [(key, one.unit) for key, one in known.items()]

    def scenario(self, name: str, point: Point, setting: str | None = None) -> dict[str, Any]:
        """The record of a scenario: one of the motions at a point.

        Args:
            setting: name of its setting; None for one that stands for the point, and with seeds,
                which go by that.

        Raises:
            InputError: the motion has no such setting, or not this value of it.
        """
        base = self.bench.run.motion(name)
        given = {**self.fixed, **dict(zip((a.name for a in self.design.axes), point, strict=True))}
        kind = kind_of(target_motion(base))
        if kind is None:
            problem = "is a motion of your own, without settings that a search could vary"
            raise InputError(
                "`motion`", name, problem, "name a motion of recast or a scenario file"
            )
        known = MOTION_SCHEMAS[kind].quantities
        # The rollout's seed comes from the whole record, the name of its setting included.
        seed = {SEED: given.pop(SEED)} if SEED in given else {}
        for key in given:
            if key not in known:
                problem = f"has no setting {key}"
                raise InputError("`motion`", name, problem, f"choose one of {', '.join(known)}")
        record = scenario_record(base)
        if setting is None or seed:
            setting = value_hash({**motion_numbers(target_motion(base)), **given, **seed})[:10]
        for part in (record, *record.get("actors", {}).values()):
            part["settings"] = {setting: part["settings"][base.setting]}
        record["settings"][setting].update(given)
        motion_of_record(record, f"{name} with {told_point(self.design.axes, point)}")
        return record

    def record(self) -> dict[str, Any]:
        """What makes this study another than others: plain data. More trials make no other."""
        bench, metrics = self.bench.record(), self.bench.run.metrics
        return {
            **{key: bench[key] for key in ("config", "drive", "scenes")},
            "format": SEARCH_FORMAT,
            "version": SEARCH_VERSION,
            "fixed": dict(sorted(self.fixed.items())),
            "over": [
                [
                    *(axis.name, axis.low, axis.high, list(axis.choices)),
                    *filter(None, [axis.occurs]),
                ]
                for axis in self.design.axes
            ],
            "design": self.design.name,
            "seed": self.design.seed,
            **({"trials": self.design.trials} if self.design.name == "grid" else {}),
            "objective": self.objective.text,
            **({"metrics": [*map(METRICS.source, metrics)]} if metrics else {}),
        }


def resolve_search(
    bench: Callable[[Sequence[str]], BenchSettings],
    *,
    motions: Sequence[str],
    over: Sequence[str],
    fixed: Mapping[str, float],
    objective: str,
    design: str,
    trials: int,
    seed: int,
) -> SearchSettings:
    """A search from words.

    Args:
        bench: function that gives all else for motions of these names.
        motions: motions or scenarios; none for cut-in-a.
        over: see `parse_axis`; none for gap=2:40.
        fixed: values of settings by name.

    Raises:
        InputError: a word is wrong.
    """
    axes = tuple(parse_axis(text) for text in over or ("gap=2:40",))
    chosen = Design(design, axes, trials, seed)
    named = tuple(dict.fromkeys(one_setting(name) for name in motions or ("cut-in-a",)))
    made = bench(named)
    asked = parse_objective(objective, [one.name for one in own_metrics(made.run.metrics)])
    run = made.run.model_copy(update={"end_on_contact": asked.threshold is None})
    return SearchSettings(replace(made, run=run), chosen, asked, dict(fixed))


def parse_fixed(words: Sequence[str]) -> dict[str, float]:
    """Values by name of words SETTING=VALUE.

    Raises:
        InputError: a word is none.
    """
    values: dict[str, float] = {}
    for text in words:
        name, _, value = text.partition("=")
        try:
            values[name] = float(value)
        except ValueError:
            mend = "write SETTING=VALUE"
            raise InputError("`set`", text, "is no setting with a number", mend) from None
    return values


def _corners(axes: Sequence[Axis]) -> Iterator[Point]:
    yield from product(*((axis.value(0.0), axis.value(1.0)) for axis in axes))


def told_point(axes: Sequence[Axis], point: Point) -> str:
    """A point in words, such as "gap 12.5 m, initial_speed 0.8 of v_r"."""
    return ", ".join(f"{a.name} {v:g} {a.unit}".rstrip() for a, v in zip(axes, point, strict=True))


def one_setting(name: str) -> str:
    """The name of one scenario: of a motion, its first setting; a file's path stays what it is."""
    return name if name.endswith((".yaml", ".yml")) else scenario_name(_scripted(name))


def _scripted(name: str) -> ScriptedMotion:
    return motion(name)  # type: ignore[return-value]  # by name there are no others


@dataclass(frozen=True)
class TrialTask(RolloutTask):
    """A trial: a rollout of a scenario that the grid's configuration does not name.

    Attributes:
        line: line that it belongs to.
        trial: the trial.
        record: its scenario.
    """

    line: SearchLine | None = None
    trial: Trial | None = None
    record: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class TrialOutcome(SceneOutcome):
    """What came of a trial.

    Attributes:
        result: margin, `MEASURES`, columns of metrics.json, what the scenario asks of a driver
            (see `Difficulty`), reference of the rollout; or `failure`, the reason why there is
            no verdict, and `refused`, whether the scenario itself was impossible.
    """

    result: Mapping[str, Any] | None = None


class SearchWorker(BenchWorker):
    """Does trials."""

    kept = 4

    def _do(self, task: GridTask, run: SceneRun) -> RolloutTimes | None:
        if isinstance(task, TrialTask):
            config = run.artefacts.config
            own = {task.motion: dict(task.record)}
            run.artefacts.config = config.model_copy(update={"own_motions": own})
        return super()._do(task, run)

    def _outcome(self, task: GridTask, times: RolloutTimes | None) -> SceneOutcome:
        outcome = super()._outcome(task, times)
        if not isinstance(task, TrialTask):
            return outcome
        result = self._judged(task, self._scene_run(task))
        return TrialOutcome(**{**vars(outcome), "result": result})

    @cached_property
    def _asked(self) -> dict[str, dict[str, Any]]:
        """What scenarios ask of a driver, by log and scenario; the same for all arms."""
        return {}

    def _judged(self, task: TrialTask, run: SceneRun) -> dict[str, Any]:
        artefacts = run.artefacts
        artefact = artefacts.used[task.use]
        found = read_rollout(artefact.path)
        if not isinstance(found, Rollout):
            refused = found.error == InputError.__name__
            return {"failure": found.reason, "refused": refused}
        own = own_metrics(artefacts.config.metrics)
        metrics = rollout_metrics(found, artefacts.source.map, own)
        key = f"{task.scene.id}/{task.motion}"
        if key not in self._asked:
            setup = artefacts.setup(task.motion, artefacts.arms[task.arm])
            self._asked[key] = difficulty(setup).to_json()
        return {
            "margin": self._objective.margin(metrics),
            "measures": measured(metrics),
            "driver": self._asked[key],
            "rollout": artefact.reference,
        }

    def __init__(
        self, store: Any, settings: BenchSettings, objective: Objective, fetch: Any
    ) -> None:
        super().__init__(store, settings, False, fetch)
        self._objective = objective


class SearchDesk:
    """The tasks of a search that are ready, and what came of them.

    Streets and vehicles go first; then the lines of one log after the other, as a worker keeps few
    logs open.
    """

    def __init__(self, settings: SearchSettings, database: StudyDatabase, owner: str) -> None:
        self._settings = settings
        run = settings.bench.run
        self._scenes = {scene.id: scene for scene in settings.bench.scenes}
        self._logs: dict[str, str | None] = {}
        self._used: dict[str, dict[str, str]] = {scene: {} for scene in self._scenes}
        self.failed: dict[str, str] = {}
        """Reasons of logs whose streets or vehicles could not be made, by log."""
        self.lines = {
            line: database.line(line, settings.design, owner)
            for line in (
                SearchLine(scene, name, planner, arm.name)
                for scene in self._scenes
                for name in run.motions
                for planner in run.planners
                for arm in run.arms
            )
        }
        self._preparing = [
            scene
            for scene in settings.bench.scenes
            if not all(one.finished for line, one in self.lines.items() if line.scene == scene.id)
        ]
        self.total = len(self._preparing) + settings.design.total * len(self.lines)

    @property
    def done(self) -> int:
        """How many tasks are done."""
        made = len(self._logs) + len(self.failed)
        return made + sum(one.done for one in self.lines.values())

    @property
    def finished(self) -> bool:
        """Whether nothing is left to do, here or elsewhere."""
        return all(one.finished or k.scene in self.failed for k, one in self.lines.items())

    def take(self) -> GridTask | None:
        """The next task, or None where there is none now."""
        if self._preparing:
            return SceneTask(self._preparing.pop(0))
        for line, trials in self.lines.items():
            if line.scene not in self._logs:
                continue
            trial = trials.next()
            if trial is not None:
                record = self._settings.scenario(line.motion, trial.point)
                name = f"{record['name']}-{next(iter(record['settings']))}"
                scene, log = self._scenes[line.scene], self._logs[line.scene]
                task = TrialTask(scene, log, {}, name, line.planner, line.arm)
                return replace(task, line=line, trial=trial, record=record)
        return None

    def needed(self, task: GridTask) -> tuple[str, ...]:
        """References of what the log of a task has, but for rollouts."""
        used = self._used[task.scene.id].values()
        return tuple(dict.fromkeys(one for one in used if not one.startswith("rollouts/")))

    def note(self, task: GridTask, outcome: SceneOutcome) -> None:
        """A task is done."""
        if isinstance(task, TrialTask):
            assert task.line is not None and task.trial is not None
            result = outcome.result if isinstance(outcome, TrialOutcome) else None
            if result is None:
                refused = outcome.error == InputError.__name__
                result = {"failure": f"{outcome.error}: {outcome.reason}", "refused": refused}
            self.lines[task.line].tell(task.trial, result)
        elif outcome.error is not None:
            self.failed[task.scene.id] = outcome.reason or outcome.error
        else:
            self._logs[task.scene.id] = outcome.log
            self._used[task.scene.id] |= outcome.used


@dataclass(frozen=True)
class SearchResults:
    """All trials of a study.

    Attributes:
        lines: trials by line, in the order in which they were proposed.
        failed: reasons of logs whose streets or vehicles could not be made, by log.
    """

    settings: SearchSettings
    lines: Mapping[SearchLine, tuple[Trial, ...]]
    failed: Mapping[str, str]


def run_search(
    settings: SearchSettings,
    out: Path,
    console: Console,
    *,
    workers: int = 1,
    ray: str | None = None,
    store: str | Path | None = None,
    database: str | Path | None = None,
    study: str | None = None,
) -> SearchResults:
    """Run all trials that are not done yet.

    A study that was stopped goes on; for one seed the trials are the same, whoever does them.

    Args:
        out: folder that is new, empty, or of this very study.
        store: folder or address of the artefacts; beside `out` where none is named.
        database: SQLite file or address; None for a file in `out`.
        study: name of the study in the database; None for the name of `out`.
        ray: address of a Ray cluster, see `run_closed_loop`.

    Raises:
        InputError: bad settings, another study in `out` or in the database, another process at work
            in `out`, before anything is written; or a worker was killed.
    """
    team = Workers(out, workers, ray, store)
    record = settings.record()
    resumes = (out / RECORD_FILE).is_file()
    if not resumes:
        check_grid(settings.bench)
    begin(out, record, RECORD_FILE)
    with files.alone_in(out):
        place = out / DATABASE_FILE if database is None else database
        book = StudyDatabase(place, study or out.absolute().name, record)
        desk = SearchDesk(settings, book, str(out.absolute()))
        if resumes and not desk.finished:
            check_grid(settings.bench)
        bench = settings.bench.absolute() if ray is not None else settings.bench

        def done(task: GridTask, outcome: SceneOutcome) -> None:
            desk.note(task, outcome)
            bar(desk.done, desk.total)

        with ProgressBar("trials", console, desk.total) as bar:
            bar(desk.done, desk.total)
            while not desk.finished:
                team.do(SearchWorker, (bench, settings.objective), bench, desk, done)
                if not desk.finished:  # others are at work on the rest
                    time.sleep(_POLL)
    lines = {line: tuple(trials.trials) for line, trials in desk.lines.items()}
    return SearchResults(settings, lines, desk.failed)
