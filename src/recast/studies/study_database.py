"""The trials of a search in a database, on which several processes and machines may work."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from recast.core.errors import InputError
from recast.runs.run_folder import first_difference
from recast.studies.designs import Design, Point

try:
    import optuna
    import sklearn  # noqa: F401  # of designs, which import it when it is needed
    from optuna.trial import TrialState
    from sqlalchemy.exc import SQLAlchemyError
except ModuleNotFoundError as error:
    raise InputError(
        str(error.name), "module", "is not installed", "pip install 'recast-sim[search]'"
    ) from None

_ABANDONED = 900.0
"""Seconds after which a trial that another process began is begun again."""

optuna.logging.set_verbosity(optuna.logging.WARNING)


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
