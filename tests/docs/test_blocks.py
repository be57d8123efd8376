"""Code of the documentation: it compiles, its names and options exist, and some of it runs."""

from __future__ import annotations

import re
import shutil
import typing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import recast
import recast.cli.main as command_line
from recast.splats import write_ply
from support.doc_blocks import PAGES, REPOSITORY, Block, blocks, commands, faults
from support.own_parts import Box

SHOWN = [block for page in PAGES for block in blocks(page)]
PYTHON = [block for block in SHOWN if block.language == "python"]
SHELL = [(block, line, words) for block in SHOWN for line, words in commands(block)]

NEEDED = {
    "run": "log --track 0 --out x",
    "eval generation": "--model a=template --set set --out x",
}
"""What "..." stands for after these commands."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_python_names_exist(page: Path) -> None:
    wrong = [f"{block}: {one}" for block in PYTHON if block.page == page for one in faults(block)]
    assert not wrong, "\n".join(wrong)


def test_a_wrong_name_and_a_wrong_keyword_are_found() -> None:
    text = "import recast\nrecast.nothing\nfrom recast.logs import wrong\nrecast.load_log(1)\n"
    text += "recast.write_log(log, 'x', speed=3)\n"
    found = faults(Block(REPOSITORY / "README.md", 10, "python", text))
    assert sorted(found) == [
        "line 11: no recast.nothing",
        "line 12: no recast.logs.wrong",
        "line 14: recast.write_log takes no speed",
    ]


@pytest.fixture
def parsed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Parses a command without running it; returns what was refused, or ""."""
    union = typing.get_args(command_line.Command)[0]
    for member in typing.get_args(union):
        monkeypatch.setattr(typing.get_args(member)[0], "__call__", lambda self: None)

    def run(words: list[str]) -> str:
        try:
            code = command_line.main(words)
        except SystemExit as ended:  # --help
            code = ended.code or 0
        return capsys.readouterr().err if code else ""

    return run


def test_shell_commands_are_understood(parsed) -> None:
    wrong = []
    for block, line, words in SHELL:
        if refused := parsed(_completed(words)):
            page = block.page.relative_to(REPOSITORY)
            wrong.append(f"{page}:{line}: recast {' '.join(words)}\n  {refused}")
    assert len(SHELL) > 80 and not wrong, "\n".join(wrong)


def _completed(words: list[str]) -> list[str]:
    """Words in which "..." after a command stands for the arguments that it needs."""
    for command, needed in NEEDED.items():
        if words[: command.count(" ") + 2] == [*command.split(), "..."]:
            return [*command.split(), *needed.split(), *words[command.count(" ") + 2 :]]
    return words


def test_a_wrong_option_is_refused(parsed) -> None:
    assert "--moton" in parsed(["run", "log", "--track", "0", "--out", "x", "--moton", "cut-in"])
    assert parsed(["run", "log", "--track", "0", "--out", "x", "--motion", "cut-in"]) == ""


def test_the_home_page_begins_with_the_commands_of_the_readme() -> None:
    home = REPOSITORY / "docs" / "index.md"
    assert home.read_text().startswith("# recast\n\n```bash\ngit clone ")
    lines = next(blocks(home)).text.splitlines()
    assert lines[1:] == next(blocks(REPOSITORY / "README.md")).text.splitlines()


def test_the_tutorial_trains_one_street() -> None:
    pages = [words for block, _, words in SHELL if block.page.name == "tutorial.md"]
    [trained] = [words[-1] for words in pages if words[:2] == ["scene", "train"]]
    runs = [words for words in pages if words[0] == "run"]
    assert len(runs) == 2
    assert all(words[words.index("--scene") + 1] == trained for words in runs)


# Blocks that run, on the tiny drive of the tests


@pytest.fixture(scope="module")
def log_folder(tiny_log_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny log in a folder of its own; the store comes to lie beside it."""
    folder = tmp_path_factory.mktemp("blocks") / "log"
    shutil.copytree(tiny_log_folder, folder)
    return folder


def block_of(page: str, first: str) -> str:
    """The text of the one Python block of a page that has these words."""
    (found,) = (one for one in PYTHON if one.page.name == page and first in one.text)
    return found.text


def run(text: str, log_folder: Path, names: dict[str, Any], **changes: str) -> dict[str, Any]:
    """Execute a block with the tiny log in place of its log; returns the names that it sets."""
    for old, new in {"runs/kitti/log": str(log_folder), **changes}.items():
        assert old in text, old
        text = text.replace(old, new)
    exec(compile(text, "block", "exec"), names)
    return names


def test_the_library_page_from_log_to_report(log_folder: Path) -> None:
    text = block_of("library.md", "recast.reconstruct(log)")
    text = text.replace("reconstruct(log)", "reconstruct(log, iterations=20, scale=0.5)")
    car = log_folder.parent / "car.ply"  # a box, not refined: the template takes ten seconds
    write_ply(car, Box().generate(None, 0).gaussians)  # type: ignore[arg-type]
    text = text.replace("scene=scene)", f"generator={str(car)!r}, axes='x,z')")
    text = text.replace("gtrs-mini", "idm-follower").replace(
        'motion("cut-in")}',
        'motion("advancing-a")}, settings=recast.RolloutSettings(steps=10), scale=0.25',
    )
    text = text.replace('"runs/kitti/report"', repr(str(log_folder.parent / "report")))
    names = run(text, log_folder, {})
    assert names["sim"].done and (log_folder.parent / "report" / "index.html").is_file()


def test_the_loop_of_the_scenarios_page(log_folder: Path) -> None:
    text = block_of("scenarios.md", "observation = sim.reset()").replace("cut-in-b", "advancing-a")
    names = run(text, log_folder, {})
    assert names["rollout"].steps_run > 0
    setup = block_of("scenarios.md", "run_rollout(setup").replace("cut-in-b", "advancing-a")
    exec(setup, names)
    assert np.array_equal(names["rollout"].ego, names["sim"].rollout.ego)


def test_the_planner_of_the_how_to_page_drives(log_folder: Path) -> None:
    names: dict[str, Any] = {"log": recast.load_log(log_folder)}
    exec(block_of("my_planner.md", "class Careful"), names)
    exec(block_of("my_planner.md", "class Looking"), names)
    text = block_of("my_planner.md", "NullRenderer").replace("cut-in-a", "advancing-a")
    exec(text, names)
    assert names["rollout"].planner == "careful"


def test_the_probe_goes_where_the_how_to_page_says() -> None:
    text = block_of("my_planner.md", "left_arc")
    names: dict[str, Any] = {}
    exec(text, names)
    said = [float(one) for one in re.findall(r"([0-9.]+) (?:m|rad)\b", text.split("m/s:")[1])]
    assert np.allclose([names[one] for one in ("x", "y", "heading")], said, atol=0.06)


def test_the_environment_of_the_planners_page(log_folder: Path) -> None:
    pytest.importorskip("gymnasium")
    text = block_of("planners.md", "gymnasium.make").replace("cut-in-b", "advancing-a")
    text = text.replace('"cut-in"', '"advancing"')
    names = run(text, log_folder, {"waypoints": np.zeros((40, 3))})
    assert names["observation"]["ego"].shape == (11,)


def test_reading_a_log_on_the_data_page(log_folder: Path) -> None:
    text = block_of("data.md", "track_points(log")
    names = run(text, log_folder, {})
    assert names["image"].shape[2] == 3 and names["points"].shape[1] == 3
