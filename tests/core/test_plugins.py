"""One rule for every kind of part: objects, prefixes, names, folders, files, `module:attribute`."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from typing import Any

import pytest

from recast.core import plugins
from recast.core.errors import InputError
from recast.core.plugins import Registry

MODULE = """
class Cup:
    def __init__(self, source="code", size=1, *, colour="white"):
        self.source, self.size, self.colour = str(source), size, colour
    def pour(self): ...
def read_folder(path, size=1): return Cup(f"folder {path}", size)
def read_file(path): return Cup(f"file {path}")
def read_rest(text, size=1): return Cup(f"rest {text}", size)
def empty(): return object()
def itself(): return Cup
def failing(): raise RuntimeError("out of\\nclay")
def leaving(): raise SystemExit(3)
value = 3
"""

CUPS = Registry(
    "cup",
    "recast.tests.cups",
    members=("pour", "size"),
    protocol="cups.Cup",
)
ENTRIES = {
    "recast.tests.cups": {"plain": "cup_shelf:Cup", "theirs": "cup_shelf:Cup"},
    "recast.tests.cups.folder": {"any": "cup_shelf:read_folder"},
    "recast.tests.cups.files": {"cup": "cup_shelf:read_file"},
    "recast.tests.cups.prefixes": {"shelf": "cup_shelf:read_rest"},
    "recast.tests.cups.experimental": {"plain": "cup_shelf:Cup"},
    "recast.tests.pots": {"pour": "cup_shelf:read_rest"},
}


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of the user's code, which is the working directory and holds a folder `mine`."""
    (tmp_path / "cup_shelf.py").write_text(MODULE)
    (tmp_path / "mine").mkdir()
    (tmp_path / "plain").mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    installed = EntryPoints(
        EntryPoint(name, code, group)
        for group, named in ENTRIES.items()
        for name, code in named.items()
    )
    monkeypatch.setattr(plugins, "entry_points", lambda group: installed.select(group=group))
    yield tmp_path
    sys.modules.pop("cup_shelf", None)


@pytest.mark.parametrize(
    ("value", "source", "place"),
    [
        ("plain", "code", None),
        ("theirs", "code", None),
        ("cup_shelf:Cup", "code", None),
        ("shelf:upper/left", "rest upper/left", None),
        ("mine", "folder mine", "mine"),
        ("./plain", "folder plain", "plain"),
        (Path("plain"), "folder plain", "plain"),
        ("far/away", "folder far/away", "far/away"),
        ("a.CUP", "file a.CUP", "a.CUP"),
        ("far/a.cup", "file far/a.cup", "far/a.cup"),
    ],
)
def test_what_a_value_stands_for(value: Any, source: str, place: str | None) -> None:
    assert CUPS.resolve(value).source == source
    assert CUPS.place(value) == (None if place is None else Path(place))
    assert CUPS.resolve(value) is not CUPS.resolve(value), "made anew"


def test_an_object_is_returned_as_it_is() -> None:
    cup = CUPS.resolve("plain")
    assert CUPS.resolve(cup, size=2) is cup and cup.size == 1
    assert not CUPS.takes(cup, "size")


def test_options_are_given_to_code_that_takes_them() -> None:
    for value, taken in {"plain": True, "shelf:x": True, "mine": True, "a.cup": False}.items():
        assert CUPS.takes(value, "size") is taken
        assert CUPS.resolve(value, size=5, unknown=0).size == (5 if taken else 1)
    assert CUPS.resolve("cup_shelf:Cup", colour="red").colour == "red"
    assert CUPS.make("plain", size=3).size == 3


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (
            "mug",
            "cup: mug: is not known; choose one of plain, theirs, install its package, or give a "
            r"folder or a file \*.cup or shelf:... or a path module:attribute",
        ),
        ("", "is not known; choose one of plain"),
        ("plian", r"is not known; did you mean plain\?"),
        ("cup_shelf.Mug", r"is not known; did you mean cup_shelf:Mug\?"),
        ("cup_shelf:Cap", r"cup_shelf.py does not define 'Cap'; did you mean cup_shelf:Cup\?"),
        ("cup_shelf:empty", "made object, which lacks pour, size; return a cup; see cups.Cup for"),
        ("cup_shelf:itself", "made the class Cup; return a cup"),
        (
            "cup_shelf:failing",
            r"cannot be made \(RuntimeError: out of clay, cup_shelf.py line 11\)",
        ),
        ("cup_shelf:leaving", r"cannot be made \(SystemExit: 3, cup_shelf.py line 12\)"),
        ("cup_shelf:value", "cannot be called; name a class or a function"),
        ("cup_shelf:none", "cannot be imported: .*cup_shelf.py does not define 'none'"),
        ("no_such_module:x", r"cannot be imported \(ModuleNotFoundError.*; run in the folder"),
        (3, "cup: int: is int, which lacks pour, size; give a cup"),
        (Registry, "cup: type: is the class Registry"),
        (None, "is NoneType, which lacks"),
    ],
)
def test_anything_else_is_one_line(value: Any, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        CUPS.resolve(value)
    assert "\n" not in str(error.value)


def test_a_kind_that_reads_nothing_knows_no_places(here: Path) -> None:
    cups = replace(CUPS, group="recast.tests.nothing")
    for value in ("mine", here, "a.cup", "far/away", "shelf:x"):
        assert cups.place(value) is None
        with pytest.raises(InputError, match=r"is not known|cannot be imported"):
            cups.resolve(value)


def test_a_kind_whose_code_is_the_part() -> None:
    pots = Registry("pot", "recast.tests.pots", members=("__call__",), makes_parts=False)
    assert pots.resolve("pour")("x").source == pots.resolve("cup_shelf:read_rest")("x").source
    assert pots.resolve(len) is len
    with pytest.raises(InputError, match="made int, which lacks __call__"):
        pots.resolve("cup_shelf:value")


@pytest.mark.parametrize("module", ["cup_shelf", "recast_mine"])
def test_torch_is_there_before_foreign_code(
    module: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (here / f"{module}.py").write_text(MODULE)
    imported: list[str] = []
    real = importlib.import_module
    monkeypatch.setattr(
        importlib, "import_module", lambda name: imported.append(name) or real(name)
    )
    CUPS.resolve(f"{module}:Cup")
    assert imported[:2] == ["torch", module], "what it does to torch is put back"
    sys.modules.pop("recast_mine", None)


def test_experimental_parts_are_marked() -> None:
    assert CUPS.labels() == ("plain (experimental)", "theirs")
    assert CUPS.names() == ("plain", "theirs")


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("importer", "py123d"),
        ("planner", "navsim:my.module:Agent"),
        ("planner", "alpasim:localhost:6789"),
        ("restorer", "harmonizer:localhost:80"),
    ],
)
def test_parts_of_the_bridges_are_named_where_these_are_absent(kind: str, name: str) -> None:
    absent = Registry(kind, "recast.tests.nothing")
    with pytest.raises(
        InputError, match=r"which is not installed; run pip install 'recast-sim\[bridges\]'"
    ):
        absent.resolve(name)
