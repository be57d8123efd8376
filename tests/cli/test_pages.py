"""Errors point to pages of the documentation, which every installation has."""

from __future__ import annotations

import json
import pickle
import re
import sys
from pathlib import Path

import pytest

from recast.cli.main import main
from recast.cli.shared import PAGES
from recast.core.errors import LINE_LIMIT, InputError

ROOT = Path(__file__).parents[2]
SOURCES = sorted((ROOT / "src" / "recast").rglob("*.py"))


def test_every_area_is_a_module_of_ours() -> None:
    names = {".".join(path.relative_to(ROOT / "src").with_suffix("").parts) for path in SOURCES}
    names = {name.removesuffix(".__init__") for name in names}
    assert all(any(name.startswith(area) for name in names) for area in PAGES)


@pytest.mark.parametrize(
    ("words", "page"),
    [
        (["weights", "path", "nonesuch"], "recast docs weights#names"),
        (["log", "info", "{}/none"], "recast docs data#the-log-folder"),
        (
            ["log", "import", "kitti", "{}", "--drive", "x", "--out", "{}/o"],
            "recast docs data#what-can-be-read",
        ),
        (["scenario", "list", "{}/none.yaml"], "recast docs scenarios#your-own-as-a-file"),
        (["store", "list", "{}"], "recast docs runs#the-store"),
        (["demo", "--planner", "nonesuch", "--out", "{}/demo"], "recast docs planners#built-in"),
        (["trellis", "verify", "{}"], "recast docs image_to_3d#model-folders"),
        (["doctor", "--nonesuch"], None),
    ],
)
def test_an_error_names_the_page_that_helps(
    words: list[str], page: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([word.replace("{}", str(tmp_path)) for word in words]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.endswith(f"; see {page}") if page else "docs" not in line
    assert len(line) <= LINE_LIMIT + len("recast: ")


def test_every_installation_has_the_pages(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--json"]) == 0
    rows = {row["part"]: row for row in json.loads(capsys.readouterr().out)}
    folder = Path(rows["docs"]["detail"])
    assert all((folder.parent / page.partition("#")[0]).is_file() for page in PAGES.values())
    installed = re.search(
        r"install\(\s*DIRECTORY docs/\s+(.*?)\)", (ROOT / "CMakeLists.txt").read_text(), re.S
    )
    assert installed and installed[1].startswith("DESTINATION recast/docs")


def test_an_error_may_name_its_own_page_and_keeps_it() -> None:
    error = InputError("x" * 900, "field", "problem", "mend", page="docs/install.md#extras")
    assert str(error).endswith("; see docs/install.md#extras") and len(str(error)) == LINE_LIMIT
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.page) == (str(error), error.page)
    assert "see docs" not in str(InputError("x", "field", "problem", "mend"))


def test_a_missing_package_points_to_the_extras(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    assert main(["demo", "--out", str(tmp_path / "demo")]) == 2
    assert capsys.readouterr().err.rstrip().endswith("see recast docs install#extras")
