from __future__ import annotations

import json
import threading
from datetime import UTC, datetime
from pathlib import Path
from typing import get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.core import files
from recast.core.errors import InputError
from recast.recar.screening import DECISIONS, Conflict, Decision, Screening
from recast.recar.targets.decisions import change_line, record_text

NAMES = ("a", "b", "c")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return make(tmp_path)


def make(folder: Path) -> Path:
    for name in NAMES:
        files.write_json(folder / "records" / f"{name}.json", {})
    return folder


def stored(folder: Path) -> dict[str, Decision]:
    """What another program reads."""
    record = json.loads((folder / "screening.json").read_text())
    assert (record["format"], record["version"]) == ("recast-screening", 1)
    found: dict[str, Decision] = record["decisions"]
    return found


def test_nothing_is_decided_without_a_file(folder: Path) -> None:
    screening = Screening(folder)
    assert dict(screening.decisions) == {}
    assert screening.decision("a") is None
    assert screening.undo() is None
    assert screening.decisions == {}
    assert not (folder / "screening.json").exists()
    assert get_args(Decision) == DECISIONS


def test_each_decision_is_in_the_file_with_its_time(folder: Path) -> None:
    screening, start = Screening(folder), datetime.now(UTC).replace(microsecond=0)
    screening.decide("a", "reject")
    assert stored(folder) == {"a": "reject"}
    screening.decide("b", "reject")
    screening.decide("a", "accept")
    assert stored(folder) == {"a": "accept", "b": "reject"}
    assert sorted(screening.decisions.values()) == ["accept", "reject"]
    changes = screening.changes(0)
    assert [(c.id, c.before, c.after) for c in changes] == [
        ("a", None, "reject"),
        ("b", None, "reject"),
        ("a", "reject", "accept"),
    ]
    assert all(start <= change.time <= datetime.now(UTC) for change in changes)


def test_the_same_decision_again_is_no_change(folder: Path) -> None:
    screening = Screening(folder)
    screening.decide("a", "reject")
    screening.decide("a", "reject")
    assert screening.revision == 1
    screening.undo()
    assert screening.decision("a") is None


def test_undo_goes_back_through_earlier_sessions(folder: Path) -> None:
    first = Screening(folder)
    first.decide("a", "accept")
    first.decide("b", "reject")
    second = Screening(folder)
    second.decide("a", "reject")
    undone = [second.undo(), Screening(folder).undo(), Screening(folder).undo()]
    assert [change and change.id for change in undone] == ["a", "b", "a"]
    assert stored(folder) == {}
    last = Screening(folder)
    assert last.undo() is None
    assert last.revision == 6  # every key press is on record


@settings(max_examples=25, deadline=None)
@given(
    st.lists(
        st.one_of(st.tuples(st.sampled_from(NAMES), st.sampled_from(DECISIONS)), st.none()),
        max_size=12,
    )
)
def test_any_presses_read_back_as_they_were_made(
    tmp_path_factory: pytest.TempPathFactory, presses: list[tuple[str, Decision] | None]
) -> None:
    folder = make(tmp_path_factory.mktemp("cache"))
    screening, states = Screening(folder), [{}]
    for press in presses:
        if press is None:
            screening.undo()
            states = states[:-1] or [{}]
        elif states[-1].get(press[0]) != press[1]:
            screening.decide(*press)
            states.append({**states[-1], press[0]: press[1]})
        assert dict(Screening(folder).decisions) == states[-1]


def test_unknown_targets_and_decisions_are_refused(folder: Path) -> None:
    (folder / "secret.json").write_text("{}")
    for name in ("d", "", "../secret", "records/a", "a/../a", "/a", "..", "a\0"):
        with pytest.raises(InputError, match="not in the cache"):
            Screening(folder).decide(name, "accept")
    with pytest.raises(InputError, match="decision"):
        Screening(folder).decide("a", "maybe")  # type: ignore[arg-type]
    assert not (folder / "screening.json").exists()


def test_what_another_process_wrote_is_kept(folder: Path) -> None:
    one, other = Screening(folder), Screening(folder)
    one.decide("a", "accept")
    other.decide("b", "reject")
    one.decide("c", "accept")
    assert stored(folder) == {"a": "accept", "b": "reject", "c": "accept"}
    other.refresh()
    assert other.decision("c") == "accept"


def test_a_decision_that_was_not_seen_is_not_overruled(folder: Path) -> None:
    one, other = Screening(folder), Screening(folder)
    seen = one.revision
    other.decide("a", "reject")
    one.decide("b", "accept", revision=seen)  # about another target: no conflict
    with pytest.raises(Conflict) as caught:
        one.decide("a", "accept", revision=seen)
    assert caught.value.id == "a"
    with pytest.raises(Conflict):
        other.undo(revision=1)
    assert stored(folder) == {"a": "reject", "b": "accept"}
    one.decide("a", "accept", revision=one.revision)
    assert stored(folder)["a"] == "accept"


def test_threads_lose_nothing(tmp_path: Path) -> None:
    names = [f"v{index}" for index in range(24)]
    for name in names:
        files.write_json(tmp_path / "records" / f"{name}.json", {})
    screenings = [Screening(tmp_path), Screening(tmp_path)]

    def press(part: int) -> None:
        for name in names[part::4]:
            screenings[part % 2].decide(name, "accept")

    threads = [threading.Thread(target=press, args=(part,)) for part in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert stored(tmp_path) == dict.fromkeys(names, "accept")


def test_a_file_written_by_hand_needs_no_history(folder: Path) -> None:
    record = {"format": "recast-screening", "version": 1, "decisions": {"b": "accept"}}
    (folder / "screening.json").write_text(json.dumps(record))
    screening = Screening(folder)
    assert screening.decision("b") == "accept"
    assert screening.undo() is None
    screening.decide("b", "reject")
    screening.undo()
    assert stored(folder) == {"b": "accept"}


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("{", "JSON"),
        ("[]", "JSON"),
        ('{"format": "other", "version": 1, "decisions": {}}', "format"),
        ('{"format": "recast-screening", "version": 2, "decisions": {}}', "version"),
        ('{"format": "recast-screening", "version": 1, "decisions": {"a": "yes"}}', "decisions.a"),
        (
            '{"format": "recast-screening", "version": 1, "decisions": {}, "history": [{"id": "a", '
            '"before": null, "after": null, "time": "2026-01-01T00:00:00Z", "undo": true}]}',
            "record",
        ),
    ],
)
def test_a_broken_file_is_one_clear_line(folder: Path, text: str, field: str) -> None:
    (folder / "screening.json").write_text(text)
    with pytest.raises(InputError) as caught:
        Screening(folder)
    assert caught.value.field == field
    assert (folder / "screening.json").read_text() == text


def test_a_disk_that_is_full_changes_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    screening = Screening(folder)
    screening.decide("a", "accept")

    def full(path: Path, text: str) -> None:
        raise InputError(path, "disk", "no space left while writing", "free some space")

    with monkeypatch.context() as context:
        context.setattr(files, "write_text", full)
        with pytest.raises(InputError, match="no space"):
            screening.decide("b", "reject")
        with pytest.raises(InputError, match="no space"):
            screening.undo()
    assert screening.decision("b") is None
    assert stored(folder) == {"a": "accept"}
    screening.decide("b", "reject")
    assert stored(folder) == {"a": "accept", "b": "reject"}


def test_lines_of_the_file_are_json(folder: Path) -> None:
    assert json.loads(record_text({}, []))["history"] == []
    screening = Screening(folder)
    screening.decide("a", "accept")
    change = screening.changes(0)[0]
    assert "undo" not in json.loads(change_line(change))
