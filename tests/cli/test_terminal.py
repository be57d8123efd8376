"""What a person sees in a terminal: errors, help pages, bars, at any width and encoding."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from recast.cli import shared
from recast.cli.main import COMMANDS
from support.terminal import in_terminal, plain

WRONG = {
    "run": "LOG, --track STR, --out PATH: are missing; see recast run --help",
    "rnu": "rnu: is not a command of recast; did you mean run? see recast --help",
    "run a --track 0 --out x --stpes 4": "--stpes: is not an option of recast run; did you mean",
    "run a --track 0 --out x --seed many": "--seed: is 'many'; give an integer",
    "run a --track 0 --out x --preset omnier": "--preset: is 'omnier'; did you mean omnire?",
    "store list --store X": "--store: is not an option of recast store list; give STORE without",
}
ALL = f"""
import shlex
from recast.cli.main import main
for command in {list(WRONG)!r}:
    assert main(shlex.split(command)) == 2
"""
SETTINGS: dict[str, dict[str, str]] = {
    "colours": {},
    "dumb": {"TERM": "dumb"},
    "no colour": {"NO_COLOR": "1"},
    "ascii": {"PYTHONIOENCODING": "ascii"},
    "C": {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
}


@pytest.mark.parametrize("columns", [80, 40, 200])
def test_errors_are_plain_lines_at_any_width(columns: int) -> None:
    code, shown = in_terminal([], code=ALL, columns=columns)
    lines = plain(shown)
    assert code == 0 and len(lines) == len(WRONG), shown
    assert "x1b" not in shown and "\x1b" not in shown and "─" not in shown
    for line, said in zip(lines, WRONG.values(), strict=True):
        assert line.startswith(f"recast: command line: {said}")


@pytest.mark.parametrize("name", SETTINGS)
def test_errors_are_plain_lines_in_any_terminal(name: str) -> None:
    code, shown = in_terminal(["rnu"], **SETTINGS[name])
    assert code == 2 and plain(shown) == [f"recast: command line: {WRONG['rnu']}"]


def pages(commands: shared.Commands, *path: str) -> Iterator[list[str]]:
    """The words of all commands, groups included."""
    yield list(path)
    for name, kind in commands.items():
        yield from pages(getattr(kind, "commands", {}), *path, name)


@pytest.mark.parametrize(("columns", "name"), [(80, "colours"), (40, "ascii"), (80, "no colour")])
def test_no_help_page_is_wider_than_the_terminal(columns: int, name: str) -> None:
    words = list(pages(COMMANDS))
    assert len(words) > 70
    code = f"""
from recast.cli.main import main
for words in {words if columns == 80 and name == "colours" else words[::9]!r}:
    try:
        main([*words, "--help"])
    except SystemExit as ended:
        assert ended.code == 0
"""
    ended, shown = in_terminal([], code=code, columns=columns, **SETTINGS[name])
    lines = plain(shown)
    assert ended == 0 and len(lines) > 100, lines[-5:]
    assert [line for line in lines if len(line) > columns] == []
    assert [line for line in lines if "(default: )" in line or "(default: None)" in line] == []
    assert ("\x1b[" in shown) == (name != "no colour")
    assert shown.isascii() == (name == "ascii")


@pytest.mark.parametrize("words", [[], ["log"]])
def test_without_a_command_the_help_is_shown(words: list[str]) -> None:
    code, shown = in_terminal(words)
    assert code == 2 and plain(shown)[0].startswith("usage: recast")


def test_no_bar_stays_above_an_error_if_nothing_was_done(tmp_path: Path) -> None:
    words = ["log", "import", "kitti", str(tmp_path), "--drive", "x", "--out", "out"]
    code, shown = in_terminal(words, folder=tmp_path)
    *_, last = shown.rstrip().split("\r\n")
    before, erased, line = last.rpartition("\x1b[2K")  # the line of the bar, before it is told
    assert code == 2 and erased and before.endswith("\x1b[1A") and line.startswith("recast: ")
