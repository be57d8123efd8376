"""screening.json: what a person decided about the pseudo-targets of a cache, and when."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Annotated, Literal

from pydantic import AwareDatetime, BeforeValidator, model_validator

from recast.recar.record import IdentityName
from recast.records import Record

SCREENING_FILE = "screening.json"
SCREENING_FORMAT = "recast-screening"
SCREENING_VERSION = 1

Decision = Literal["accept", "reject"]
DECISIONS: tuple[Decision, ...] = ("accept", "reject")


def _as_it_stands(decision: object) -> object:
    # Earlier versions turned latents by 180 degrees, which their autoencoders do not turn with: of
    # the decoded voxels a third agreed. What came out rear to front is of no use as it stands.
    return "reject" if decision == "flip" else decision


_Stored = Annotated[Decision, BeforeValidator(_as_it_stands)]


class Change(Record):
    """One key press.

    Attributes:
        id: the target.
        before, after: its decision; None where it had none, or lost it.
        time: when, UTC.
        undo: it took back the last change that was not taken back yet.
    """

    id: IdentityName
    before: _Stored | None
    after: _Stored | None
    time: AwareDatetime
    undo: bool = False


class ScreeningRecord(Record):
    """Contents of screening.json.

    Attributes:
        decisions: what counts, by id; may be written by hand or by a script, without a history.
        history: every change in order of time, those that were taken back and the undoing too, so
            that any number of them can be undone by a later session.
    """

    format: Literal["recast-screening"] = "recast-screening"
    version: int = SCREENING_VERSION
    decisions: dict[IdentityName, _Stored]
    history: tuple[Change, ...] = ()

    @model_validator(mode="after")
    def _undone_was_done(self) -> ScreeningRecord:
        standing_changes(self.history)
        return self


def standing_changes(history: Iterable[Change]) -> list[Change]:
    """The changes that were not undone, oldest first.

    Raises:
        ValueError: more was undone than done.
    """
    standing: list[Change] = []
    for change in history:
        if not change.undo:
            standing.append(change)
        elif standing:
            standing.pop()
        else:
            raise ValueError(f"history undoes a change of {change.id} that is not in it")
    return standing


def change_line(change: Change) -> str:
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
