"""screening.json: what a person decided about pseudo-targets; read, made, undone, always saved."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from pydantic import AwareDatetime, model_validator

from recast.core import files
from recast.core.errors import InputError
from recast.core.files import disk_errors
from recast.core.records import Record, read_record
from recast.recar.set_records import IdentityName, is_identity_name

SCREENING_FILE = "screening.json"
SCREENING_FORMAT = "recast-screening"
SCREENING_VERSION = 1

Decision = Literal["accept", "reject"]
DECISIONS: tuple[Decision, ...] = ("accept", "reject")
_LOCK_FILE = ".screening.lock"
_MEND = "restore it from a copy, or remove it to begin the screening again"


class DecisionChange(Record):
    """One key press.

    Attributes:
        id: id of the target.
        before, after: decision about it before and after; None where it had none, or lost it.
        time: time of the change, UTC.
        undo: whether it took back the last change that was not taken back yet.
    """

    id: IdentityName
    before: Decision | None
    after: Decision | None
    time: AwareDatetime
    undo: bool = False


class ScreeningRecord(Record):
    """Contents of screening.json.

    Attributes:
        decisions: decisions that count, by id; may be written by hand or by a script, without a
            history.
        history: every change in order of time, those that were taken back and the undoing too, so
            that any number of them can be undone by a later session.
    """

    format: Literal["recast-screening"] = "recast-screening"
    version: int = SCREENING_VERSION
    decisions: dict[IdentityName, Decision]
    history: tuple[DecisionChange, ...] = ()

    @model_validator(mode="after")
    def _undone_was_done(self) -> ScreeningRecord:
        standing_changes(self.history)
        return self


def standing_changes(history: Iterable[DecisionChange]) -> list[DecisionChange]:
    """The changes that were not undone, oldest first.

    Raises:
        ValueError: more was undone than done.
    """
    standing: list[DecisionChange] = []
    for change in history:
        if not change.undo:
            standing.append(change)
        elif standing:
            standing.pop()
        else:
            raise ValueError(f"history undoes a change of {change.id} that is not in it")
    return standing


def change_line(change: DecisionChange) -> str:
    """A change as one line of JSON."""
    return change.model_dump_json(exclude_defaults=True)


def record_text(decisions: Mapping[str, Decision], history: Iterable[str]) -> str:
    """screening.json with one decision or change a line; `history` holds lines already written.

    The lines are joined and not encoded again, since the file is written at every key press: 20,000
    targets take some milliseconds in place of a tenth of a second.
    """
    chosen = ",\n    ".join(f'"{name}": "{decision}"' for name, decision in decisions.items())
    changes = ",\n    ".join(history)
    return (
        f'{{\n  "format": {json.dumps(SCREENING_FORMAT)},\n  "version": {SCREENING_VERSION},\n'
        f'  "decisions": {{\n    {chosen}\n  }},\n  "history": [\n    {changes}\n  ]\n}}\n'
    )


class Conflict(ValueError):  # noqa: N818 - the name of what HTTP answers
    """Somebody else decided in the meantime; nothing was changed.

    Attributes:
        id: the target about which they decided.
    """

    def __init__(self, name: str) -> None:
        super().__init__(f"{name} was decided elsewhere in the meantime")
        self.id = name


class Screening:
    """The screening of one cache: `FOLDER/screening.json`.

    Every change is in the file when the method returns, written whole to another name and renamed.
    Several threads and processes may screen one cache: each change begins with what the others
    have written, behind a lock that the system drops when a process is killed.

    Args:
        folder: folder of the cache. Without a file in it nothing is decided yet.

    Raises:
        InputError: screening.json is broken, or of another format or version.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self._path = self.folder / SCREENING_FILE
        self._thread = threading.RLock()
        self._file: tuple[int, ...] | None = None
        self._decisions: dict[str, Decision] = {}
        self._history: list[DecisionChange] = []
        self._lines: list[str] = []
        self._standing: list[DecisionChange] = []
        self.refresh()

    def refresh(self) -> None:
        """Read what another process wrote since; next to nothing where none did."""
        with self._thread:
            try:
                found = _file_state(self._path.stat())
            except FileNotFoundError:
                found = None
            if found == self._file:
                return
            record = _read(self._path) if found is not None else ScreeningRecord(decisions={})
            self._decisions = dict(record.decisions)
            self._history = list(record.history)
            self._lines = [change_line(change) for change in self._history]
            self._standing = standing_changes(self._history)
            self._file = found

    @property
    def decisions(self) -> Mapping[str, Decision]:
        """All decisions by id."""
        return MappingProxyType(self._decisions)

    @property
    def revision(self) -> int:
        """Number of changes so far; it never falls, since undoing is a change too."""
        return len(self._history)

    def decision(self, name: str) -> Decision | None:
        """The decision about one target; None where there is none."""
        return self._decisions.get(name)

    def changes(self, since: int) -> list[DecisionChange]:
        """The changes after revision `since`."""
        return self._history[max(since, 0) :]

    def decide(self, name: str, decision: Decision, *, revision: int | None = None) -> None:
        """Decide about a target; again the same decision changes nothing.

        Args:
            name: id of the target.
            decision: "accept" or "reject".
            revision: revision that the decider last saw; None decides whatever others did.

        Raises:
            InputError: no such target or decision, or the disk is full; nothing was changed.
            Conflict: another decision about it after `revision`.
        """
        if decision not in DECISIONS:
            raise InputError(
                self._path, "decision", f"is {decision!r}", f"use {', '.join(DECISIONS)}"
            )
        with self._exclusive():
            self._check_known(name)
            before = self._decisions.get(name)
            if before == decision:
                return
            if revision is not None and any(c.id == name for c in self.changes(revision)):
                raise Conflict(name)
            self._append(DecisionChange(id=name, before=before, after=decision, time=_now()))

    def undo(self, *, revision: int | None = None) -> DecisionChange | None:
        """Take back the last change that was not taken back yet, of this or an earlier session.

        Args:
            revision: revision that the decider last saw; None undoes whatever others did.

        Returns:
            The change that was taken back; None where there was none left.

        Raises:
            Conflict: there were changes after `revision`, so that another one is the last.
            InputError: the disk is full; nothing was changed.
        """
        with self._exclusive():
            if not self._standing:
                return None
            if revision is not None and (missed := self.changes(revision)):
                raise Conflict(missed[-1].id)
            last = self._standing[-1]
            now = self._decisions.get(last.id)
            self._append(
                DecisionChange(id=last.id, before=now, after=last.before, time=_now(), undo=True)
            )
            return last

    def _check_known(self, name: str) -> None:
        # Of such a name no path leads out of the folder.
        known = is_identity_name(name) and (self.folder / "records" / f"{name}.json").is_file()
        if not known:
            raise InputError(
                self.folder, "target", f"{name[:100]!r} is not in the cache", "check the id"
            )

    def _append(self, change: DecisionChange) -> None:
        decisions = dict(self._decisions)
        if change.after is None:
            decisions.pop(change.id, None)
        else:
            decisions[change.id] = change.after
        line = change_line(change)
        files.write_text(self._path, record_text(decisions, [*self._lines, line]))
        self._file = _file_state(self._path.stat())
        self._decisions = decisions
        self._history.append(change)
        self._lines.append(line)
        if change.undo:
            self._standing.pop()
        else:
            self._standing.append(change)

    @contextmanager
    def _exclusive(self) -> Iterator[None]:
        lock = self.folder / _LOCK_FILE
        with disk_errors(lock), self._thread:
            lock.touch()
            with files.alone_in(lock, wait=True):
                self.refresh()
                yield


def _read(path: Path) -> ScreeningRecord:
    return read_record(path, ScreeningRecord, SCREENING_VERSION, _MEND, SCREENING_FORMAT)


def _file_state(stat: Any) -> tuple[int, ...]:
    # A rename brings another inode, a write in place another time or size.
    return stat.st_ino, stat.st_mtime_ns, stat.st_size


def _now() -> datetime:
    return datetime.now(UTC).replace(microsecond=0)
