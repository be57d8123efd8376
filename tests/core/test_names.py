from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recast.core.errors import LINE_LIMIT, InputError
from recast.core.files import folder_name, member

HOSTILE = [
    "",
    ".",
    "..",
    "../x",
    "/etc/passwd",
    "a/b",
    "a\\b",
    "a\0b",
    "a\nb",
    "A" * 300,
    "\u202etxt.exe",
    "<script>alert(1)</script>",
    ".hidden",
    "-rf",
    "con",
    "NUL.txt",
    "a.",
    "é",
    "\ud800",
]


@pytest.mark.parametrize(
    "name", ["0", "cut-in-a", "FRONT_LEFT", "image_02", "a.b+c", "_x", "A" * 100]
)
def test_plain_names_stay(name: str) -> None:
    assert folder_name(name) == name


@pytest.mark.parametrize("name", HOSTILE)
def test_any_other_name_becomes_one_component_of_a_path(name: str, tmp_path: Path) -> None:
    found = folder_name(name)
    assert Path(found).name == found
    assert found.isascii()
    assert len(found) < 100
    (tmp_path / found).mkdir()
    assert [path.name for path in tmp_path.iterdir()] == [found]


@given(st.lists(st.text(max_size=120), unique=True, max_size=20))
def test_different_names_stay_different(names: list[str]) -> None:
    assert len({folder_name(name) for name in [*HOSTILE, *names]}) == len({*HOSTILE, *names})


@given(st.text(max_size=40))
def test_a_folder_name_stays_as_it_is(name: str) -> None:
    once = folder_name(name)
    assert "~" in once or folder_name(once) == once == name


@pytest.mark.parametrize("name", ["a.ply", "deeper/a.ply", "./a.ply", "..a/b..", "é.ply"])
def test_members_are_opened_inside_of_their_folder(name: str, tmp_path: Path) -> None:
    assert member(tmp_path, name, "scene.json", "file").is_relative_to(tmp_path)


OUTSIDE = [
    "",
    ".",
    "..",
    "../../a",
    "a/../../b",
    "/etc/passwd",
    "a\0",
    "..\\b",
    "C:b",
    "a" * 5000,
    "\ud800",
]


@pytest.mark.parametrize("name", OUTSIDE)
def test_members_never_leave_it(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"scene\.json: file: names"):
        member(tmp_path, name, "scene.json", "file")


@given(*[st.text(max_size=2000)] * 4)
def test_an_error_is_one_short_line_that_can_be_printed(
    where: str, field: str, problem: str, mend: str
) -> None:
    error = InputError(where, field, problem, mend)
    line = str(error)
    assert len(line) <= LINE_LIMIT
    assert len(line.splitlines()) <= 1
    line.encode()
    assert not any(mark in line for mark in "\n\r\0\x1b\u202e\u2028")
    assert (error.where, error.field, error.problem, error.mend) == (where, field, problem, mend)


def test_a_short_error_is_told_whole() -> None:
    assert str(InputError("a/b.json", "field", "is\n  wrong", "mend it")) == (
        "a/b.json: field: is wrong; mend it"
    )


def test_a_long_path_keeps_its_end() -> None:
    line = str(InputError("x" * 400 + "/end.json", "field", "is wrong", "mend it"))
    assert line.startswith("…x")
    assert line.endswith("/end.json: field: is wrong; mend it")
