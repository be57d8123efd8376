"""The line of an error: what stays when it is too long, and what is spelled alike."""

from __future__ import annotations

import pytest

from recast.core.errors import LINE_LIMIT, InputError, nearest

NAMES = ", ".join(f"vehicle-number-{number}" for number in range(90))


@pytest.mark.parametrize(
    ("problem", "hint"),
    [
        (f"is not one of {NAMES}", "give the id of a track"),
        ("is not known", f"choose one of {NAMES}, or give a file of arms"),
        ("a" * 999, "give the id of a track"),
    ],
)
def test_the_end_of_the_hint_and_the_field_stay(problem: str, hint: str) -> None:
    line = str(InputError("/a/long/path/" * 20 + "log", "track 7", problem, hint))
    assert len(line) <= LINE_LIMIT
    assert ": track 7: " in line and line.endswith(hint.rpartition(", ")[2])
    assert "path/log: " in line and "…" in line


def test_parts_that_are_all_too_long_keep_the_limit() -> None:
    for length in (100, 300, 900):
        error = InputError("w" * length, "f" * length, "p" * length, "h" * length)
        assert len(str(error)) == LINE_LIMIT


def test_the_name_that_is_spelled_alike() -> None:
    assert nearest("NATVE", ["oracle", "Native"]) == "Native"
    assert nearest("x", ["oracle"]) is None
