"""The core without recast-bridges and recast-tools: it imports, helps, and says what is missing."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from support.doc_blocks import REPOSITORY

OTHERS = ("recast_bridges", "recast_tools", "_editable_impl_recast_")


@pytest.fixture(scope="module")
def core_alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Installed packages of this environment, less the two distributions."""
    packages = Path(sysconfig.get_path("purelib"))
    folder = tmp_path_factory.mktemp("site")
    for path in packages.iterdir():
        if not path.name.startswith(OTHERS):
            (folder / path.name).symlink_to(path)
    return folder


def ran(site: Path, code: str, *words: str) -> subprocess.CompletedProcess[str]:
    """A new process with these packages alone."""
    lines = f"import site, sys; site.addsitedir({str(site)!r})\n{code}"
    command = [sys.executable, "-S", "-P", "-c", lines, *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


MISSING = (
    (
        "serve sensorsim scene",
        "recast: command line: serve: is a command of recast-bridges, which is not installed; "
        "run pip install 'recast-sim[bridges]'",
    ),
    ("scene import mtgs x", "scene import mtgs: is a command of recast-bridges"),
    ("log export alpasim x", "log export: is a command of recast-bridges"),
    (
        "planner train",
        "planner: is a command of recast-tools, which is not installed; run make setup in",
    ),
    (
        "log import py123d x --out y",
        "py123d: is part of recast-bridges, which is",
    ),
    ("demo --planner navsim:a.b:C --out y", "navsim:a.b:C: is part of recast-bridges"),
)
"""Commands, and what they say."""
EACH = """
import recast
print(*[getattr(recast, name) and name for name in dir(recast)])
import contextlib, io, json
from recast.cli.main import main
for words in sys.argv[1:]:
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        code = main(words.split())
    print(json.dumps([words, code, said.getvalue()]))
"""


def test_what_is_missing_is_one_line_and_the_public_api_is_whole(core_alone: Path) -> None:
    done = ran(core_alone, EACH, *(words for words, _ in MISSING))
    assert done.returncode == 0, done.stderr
    names, *commands = done.stdout.splitlines()
    for (words, line), told in zip(MISSING, map(json.loads, commands), strict=True):
        assert told[:2] == [words, 2]
        assert line in told[2] and len(told[2].splitlines()) == 1, told[2]
    assert {"load_log", "reconstruct", "Simulator", "write_report"} <= set(names.split())
    assert "recast_bridges" not in done.stderr


def test_help_shows_what_is_there(core_alone: Path) -> None:
    code = "from recast.cli.main import main; sys.exit(main(['--help']))"
    alone = ran(core_alone, code).stdout
    whole = subprocess.run(
        [sys.executable, "-c", "import sys; " + code], capture_output=True, text=True, timeout=120
    ).stdout
    commands = [set(re.findall(r"^│ +• (\w+)", page, re.M)) for page in (alone, whole)]
    assert commands[1] - commands[0] == {"serve", "planner"} and "run" in commands[0]


def test_no_module_of_the_core_names_them() -> None:
    sources = sorted((REPOSITORY / "src").rglob("*.py"))
    named = [path for path in sources if re.search(r"recast_(bridges|tools)\b", path.read_text())]
    assert sources and not named
