"""Which files stand behind a name: what a fingerprint of a user's own code is made of."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest

from recast.core import plugins
from recast.core.plugins import source_files
from recast.planning import PLANNERS


@pytest.fixture
def user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of the user's on the path."""
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def _write(folder: Path, **files: str) -> None:
    for name, text in files.items():
        path = folder / f"{name.replace('__SLASH__', '/')}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def _names(root: Path, files: tuple[Path, ...]) -> list[str]:
    return [file.relative_to(root).as_posix() for file in files]


def test_a_module_and_what_it_imports_from_beside_it(user: Path) -> None:
    _write(
        user,
        lone_planner="import numpy, lone_a\ndef late():\n    from lone_pkg.deep import f\n",
        lone_a="from lone_b import x\nimport lone_planner",  # in a circle
        lone_b="raise SystemExit",  # not imported by looking
        lone_unused="",
        lone_pkg__SLASH____init__="",
        lone_pkg__SLASH__deep="",
    )
    files = source_files("lone_planner:Planner")
    expected = ["lone_a.py", "lone_b.py", "lone_pkg/__init__.py", "lone_pkg/deep.py"]
    assert _names(user, files) == [*expected, "lone_planner.py"]
    assert not {"lone_planner", "lone_a", "lone_b"} & sys.modules.keys()
    assert source_files("lone_unused:Planner") == (user / "lone_unused.py",)


def test_imports_are_found_in_every_kind_of_statement(user: Path) -> None:
    kinds = (
        "try:\n    {0}\nexcept E:\n    {1}\nelse:\n    {2}\nfinally:\n    {3}",
        "for x in y:\n    {0}\nelse:\n    while y:\n        {1}\n    else:\n        {2}",
        "if a:\n    {0}\nelif b:\n    {1}\nelse:\n    {2}",
        "class C:\n    async def f(self):\n        async with a:\n            {0}",
        "match a:\n    case 1:\n        {0}\n    case _:\n        {1}",
    )
    names, text = [], ""
    for number, kind in enumerate(kinds):
        here = [f"deep_{number}_{part}" for part in range(kind.count("{"))]
        text += kind.format(*(f"import {name}" for name in here)) + "\n"
        names += here
    _write(user, deep_all=text, **dict.fromkeys(names, ""))
    assert _names(user, source_files("deep_all:P")) == [*(f"{n}.py" for n in names), "deep_all.py"]


def test_all_of_a_package_and_the_modules_beside_it(user: Path) -> None:
    _write(
        user,
        whole__SLASH____init__="from . import part",
        whole__SLASH__part="import helper_of_whole",
        whole__SLASH__far__SLASH__unused="def broken(",
        whole__SLASH__venv__SLASH__site_packages="",
        helper_of_whole="",
        other_module="",
    )
    _write(user / "whole" / ".venv", hidden="")
    _write(user / "whole" / "site-packages", installed="")
    (user / "whole" / "weights.bin").write_bytes(b"1")
    names = _names(user, source_files("whole.part:Planner"))
    assert names == [
        "helper_of_whole.py",
        "whole/__init__.py",
        "whole/far/unused.py",
        "whole/part.py",
        "whole/venv/site_packages.py",
    ]
    assert source_files("whole:Planner") == source_files("whole.far.unused:Planner")


def test_a_folder_without_init_is_a_package(user: Path) -> None:
    _write(user, bare_folder__SLASH__mine="")
    assert _names(user, source_files("bare_folder.mine:P")) == ["bare_folder/mine.py"]


def test_of_installed_packages_their_own_files_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = tmp_path / "lib" / "site-packages"
    _write(site, their_planner__SLASH____init__="import their_library", their_library="")
    monkeypatch.syspath_prepend(site)
    found = EntryPoints([EntryPoint("theirs", "their_planner:P", PLANNERS.group)])
    monkeypatch.setattr(plugins, "entry_points", lambda group: found.select(group=group))
    assert _names(site, PLANNERS.source_files("theirs")) == ["their_planner/__init__.py"]


@pytest.mark.parametrize(
    "name", ["recast.planning.simple:left_arc", "no_such_module:x", ".x:y", ""]
)
def test_no_files(name: str) -> None:
    assert source_files(name) == ()


def test_an_edit_is_seen_though_the_module_was_imported(user: Path) -> None:
    _write(user, edited_planner="import numpy\nP = 1\n")
    assert PLANNERS.load("edited_planner:P") == 1
    _write(user, edited_planner="import edited_helper\nP = 2\n", edited_helper="")
    assert _names(user, source_files("edited_planner:P")) == [
        "edited_helper.py",
        "edited_planner.py",
    ]
