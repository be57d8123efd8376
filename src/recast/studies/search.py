"""`recast search`: where in a range of settings a planner begins to fail; see docs/search.md.

A *line* of a study is one log, motion, planner and arm: its trials are proposed by a `Design` from
what came of the earlier ones, batch by batch. They are kept in a database, on which several
processes and machines may work; the rollouts themselves are artefacts of the store.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

from rich.console import Console

from recast.core import files, value_hash
from recast.core.diagnostics import ProgressBar
from recast.core.errors import InputError
from recast.metrics import rollout_metrics
from recast.runs.rollouts import read_rollout
from recast.runs.run_folder import first_difference
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
from recast.studies.trials import Objective, difficulty, measured, parse_objective

try:
    import optuna
    import sklearn  # noqa: F401  # of designs, which import it when it is needed
    from optuna.trial import TrialState
    from sqlalchemy.exc import SQLAlchemyError
except ModuleNotFoundError as error:
    raise InputError(
        str(error.name), "module", "is not installed", "pip install 'recast-sim[search]'"
    ) from None

SEARCH_FORMAT, SEARCH_VERSION = "recast-search", 1
RECORD_FILE, DATABASE_FILE = "search.json", "search.db"
_ABANDONED = 900.0
"""Seconds after which a trial that another process began is begun again."""
_POLL = 1.0  # seconds between looks at what other processes do

optuna.logging.set_verbosity(optuna.logging.WARNING)


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
        for name in self.bench.run.motions:
            for point in _corners(self.design.axes):
                self.scenario(name, point)
        units = {key: unit for name in self.bench.run.motions for key, unit in self._units(name)}
        axes = tuple(replace(axis, unit=units[axis.name]) for axis in self.design.axes)
        object.__setattr__(self, "design", replace(self.design, axes=axes))

    def _units(self, name: str) -> list[tuple[str, str]]:
        kind = kind_of(target_motion(self.bench.run.motion(name)))
        known = {} if kind is None else MOTION_SCHEMAS[kind].quantities
        return [(key, one.unit) for key, one in known.items()]

    def scenario(self, name: str, point: Point, setting: str | None = None) -> dict[str, Any]:
        """The record of a scenario: one of the motions at a point.

        Args:
            setting: name of its setting; None for one that stands for the point.

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
        for key in given:
            if key not in known:
                problem = f"has no setting {key}"
                raise InputError("`motion`", name, problem, f"choose one of {', '.join(known)}")
        record = scenario_record(base)
        if setting is None:
            setting = value_hash({**motion_numbers(target_motion(base)), **given})[:10]
        for part in (record, *record.get("actors", {}).values()):
            part["settings"] = {setting: part["settings"][base.setting]}
        record["settings"][setting].update(given)
        motion_of_record(record, f"{name} with {told_point(self.design.axes, point)}")
        return record

    def record(self) -> dict[str, Any]:
        """What makes this study another than others: plain data. More trials make no other."""
        bench = self.bench.record()
        return {
            **{key: bench[key] for key in ("config", "drive", "scenes")},
            "format": SEARCH_FORMAT,
            "version": SEARCH_VERSION,
            "fixed": dict(sorted(self.fixed.items())),
            "over": [
                [axis.name, axis.low, axis.high, list(axis.choices)] for axis in self.design.axes
            ],
            "design": self.design.name,
            "seed": self.design.seed,
            **({"trials": self.design.trials} if self.design.name == "grid" else {}),
            "objective": self.objective.text,
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
    asked = parse_objective(objective)
    named = tuple(dict.fromkeys(one_setting(name) for name in motions or ("cut-in-a",)))
    made = bench(named)
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
class SearchLine:
    """One log, motion, planner and arm of a study."""

    scene: str
    motion: str
    planner: str
    arm: str

    @property
    def name(self) -> str:
        """Its name in the database."""
        return "/".join((self.scene, self.motion, self.planner, self.arm))


@dataclass(frozen=True)
class Trial:
    """One point of a line.

    Attributes:
        index: its number among the line's proposals.
        number: its number in the database.
        point: values of the axes.
        result: what came of it, see `SearchWorker`; None while it is not done.
    """

    index: int
    number: int
    point: Point
    result: Mapping[str, Any] | None = None

    @property
    def margin(self) -> float | None:
        """How far it is from failing, see `Objective.margin`; None if that is not known."""
        return None if self.result is None else self.result.get("margin")


@contextmanager
def _told(address: str) -> Iterator[None]:
    """Faults of the database as one line."""
    try:
        yield
    except SQLAlchemyError as error:
        reason = str(getattr(error, "orig", None) or error).splitlines()[0]
        mend = "check address, rights and space; the same command goes on"
        raise InputError(address, "database", f"cannot be used ({reason})", mend) from None


class StudyDatabase:
    """The trials of a study, in a database that other processes may use, too.

    Args:
        address: SQLite file, or the address of a database (`postgresql://...`, `mysql://...`).
        name: name of the study in it.
        record: see `SearchSettings.record`.

    Raises:
        InputError: it cannot be opened, or a study of this name is another one.
    """

    def __init__(self, address: str | Path, name: str, record: Mapping[str, Any]) -> None:
        self.address, self.name = str(address), name
        url = self.address if "://" in self.address else f"sqlite:///{self.address}"
        waits = {"connect_args": {"timeout": 60}} if url.startswith("sqlite") else {}
        try:
            with _told(self.address):
                self._storage = optuna.storages.RDBStorage(url, engine_kwargs=waits)
                root = self._study(name)
                found = root.user_attrs.get("record")
                if found is None:
                    root.set_user_attr("record", dict(record))
        except (ModuleNotFoundError, ValueError, RuntimeError) as error:
            problem = f"cannot be opened ({error})".splitlines()[0]
            mend = "give a file, or an address whose driver is installed"
            raise InputError(self.address, "database", problem, mend) from None
        if found is not None:
            differing = first_difference({key: found.get(key) for key in record}, dict(record))
            if differing is not None:
                problem = f"contains another study {name}: {differing} differs"
                mend = "give another `study`, or repeat the options of that one"
                raise InputError(self.address, "database", problem, mend)

    def _study(self, name: str) -> optuna.Study:
        return optuna.create_study(storage=self._storage, study_name=name, load_if_exists=True)

    def line(self, line: SearchLine, design: Design, owner: str) -> LineTrials:
        """The trials of a line."""
        with _told(self.address):
            return LineTrials(self._study(f"{self.name}: {line.name}"), design, owner, self.address)


class LineTrials:
    """The trials of one line: proposed, claimed and told.

    Any number of processes may do so at once. Proposals depend on results alone, so whoever comes
    first writes them; of two that came at once the earlier counts.

    Args:
        owner: who asks, so that what it began before it was killed is its own.
    """

    def __init__(self, study: optuna.Study, design: Design, owner: str, address: str) -> None:
        self._study, self._design, self._owner, self._address = study, design, owner, address
        axes = design.axes
        self._distributions: dict[str, optuna.distributions.BaseDistribution] = {
            axis.name: optuna.distributions.CategoricalDistribution(axis.choices)
            if axis.choices
            else optuna.distributions.FloatDistribution(axis.low, axis.high)
            for axis in axes
        }
        self._names = [axis.name for axis in axes]
        self._mine: dict[int, optuna.Trial] = {}
        self._waiting, self.done = 0, 0
        self.finished = False
        self.trials: list[Trial] = []
        self._left: list[tuple[Trial, optuna.Trial]] = []
        self.refresh()

    def refresh(self) -> None:
        """Look what the database has."""
        first: dict[int, optuna.trial.FrozenTrial] = {}
        with _told(self._address):
            for one in self._study.get_trials(deepcopy=False):
                if (index := one.user_attrs.get("index")) is not None:
                    first.setdefault(index, one)
        self.trials, self._left, self._waiting, self.done = [], [], 0, 0
        for index in sorted(first):
            one = first[index]
            point = tuple(one.params[name] for name in self._names)
            trial = Trial(index, one.number, point, one.user_attrs.get("result"))
            self.trials.append(trial)
            if one.state == TrialState.WAITING:
                self._waiting += 1
            elif one.state == TrialState.RUNNING:
                if one.number not in self._mine and self._abandoned(one):
                    open_again = optuna.Trial(self._study, one._trial_id)
                    self._left.append((trial, open_again))
            else:
                self.done += 1
        self.finished = self.done >= self._design.total

    def _abandoned(self, one: optuna.trial.FrozenTrial) -> bool:
        if one.user_attrs.get("owner") == self._owner:
            return True
        begun = one.datetime_start
        return begun is not None and time.time() - begun.timestamp() > _ABANDONED

    def next(self) -> Trial | None:
        """Claim a trial; None where there is none now, or the line is `finished`."""
        while not self.finished:
            if self._left:
                trial, self._mine[trial.number] = self._left.pop()
                return trial
            if self._waiting == 0:
                if self._mine:
                    return None
                self.refresh()
                if self._left:
                    continue
            if self._waiting:
                claimed = self._claim()
                if claimed is not None:
                    return claimed
                continue
            if self.done < len(self.trials):
                return None  # another process is at work on the rest
            points = self._design.proposals([(one.point, one.margin) for one in self.trials])
            if not points:
                self.finished = True
                return None
            self._propose(points)
        return None

    def _propose(self, points: Sequence[Point]) -> None:
        first = len(self.trials)
        with _told(self._address):
            for index, point in enumerate(points, first):
                trial = optuna.trial.create_trial(
                    state=TrialState.WAITING,
                    params=dict(zip(self._names, point, strict=True)),
                    distributions=self._distributions,
                    user_attrs={"index": index},
                )
                self._study.add_trial(trial)
        self.refresh()

    def _claim(self) -> Trial | None:
        self._waiting -= 1
        with _told(self._address):
            asked = self._study.ask()
            index = asked.user_attrs.get("index")
            if index is not None and index >= len(self.trials):
                self.refresh()  # proposed by another process since
            known = None if index is None else self.trials[index]
            if known is None or known.number != asked.number:
                # Nobody waited any more, or two processes proposed the same at once.
                self._study.tell(asked, state=TrialState.FAIL)
                return None
            asked.set_user_attr("owner", self._owner)
        self._mine[known.number] = asked
        return known

    def tell(self, trial: Trial, result: Mapping[str, Any]) -> None:
        """Write what came of a trial that was claimed."""
        margin, claimed = result.get("margin"), self._mine.pop(trial.number)
        with _told(self._address):
            claimed.set_user_attr("result", dict(result))
            state = TrialState.FAIL if margin is None else TrialState.COMPLETE
            self._study.tell(claimed, margin, state=state, skip_if_finished=True)
        self.trials[trial.index] = replace(trial, result=result)
        self.done += 1


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
        metrics = rollout_metrics(found, artefacts.source.map)
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
