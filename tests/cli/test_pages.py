"""Errors point to pages of the documentation, and these pages and sections exist."""

from __future__ import annotations

import pickle
import re
import sys
from pathlib import Path

import pytest
from markdown.extensions.toc import slugify

from recast.cli.main import main
from recast.cli.output import PAGES
from recast.core.errors import LINE_LIMIT, InputError

ROOT = Path(__file__).parents[2]
NAMED = re.compile(
    r"docs/(?P<page>[\w/-]+\.md)(?:#(?P<anchor>[\w-]+)|,\s+sections?\s+(?P<title>[^\"']+))?"
)
SOURCES = sorted((ROOT / "src" / "recast").rglob("*.py"))


def anchors(page: Path) -> set[str]:
    """Anchors of the headings of a page, without those inside code blocks."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S)
    titles = re.findall(r"^#+ +(.*)$", text, flags=re.M)
    return {slugify(re.sub(r"[`*]", "", title), "-") for title in titles}


def test_every_page_and_section_in_the_source_exists() -> None:
    found = 0
    for source in SOURCES:
        text = re.sub(r'"\s*\n\s*f?"', "", source.read_text())  # strings over several lines
        for match in NAMED.finditer(text):
            page = ROOT / "docs" / match["page"]
            assert page.is_file(), f"{source}: {match[0]}"
            titles = (match["title"] or "").split(" and ")
            for anchor in filter(None, [match["anchor"], *(slugify(t, "-") for t in titles)]):
                assert anchor in anchors(page), f"{source}: {match[0]}"
                found += 1
    assert found > 20


def test_every_area_is_a_module_of_ours() -> None:
    names = {".".join(path.relative_to(ROOT / "src").with_suffix("").parts) for path in SOURCES}
    names = {name.removesuffix(".__init__") for name in names}
    assert all(any(name.startswith(area) for name in names) for area in PAGES)


@pytest.mark.parametrize(
    ("words", "page"),
    [
        (["weights", "path", "nonesuch"], "docs/weights.md#names"),
        (["log", "info", "{}/none"], "docs/data.md#the-log-folder"),
        (
            ["log", "import", "kitti", "{}", "--drive", "x", "--out", "{}/o"],
            "docs/data.md#what-can-be-read",
        ),
        (["scenario", "list", "{}/none.yaml"], "docs/scenarios.md#your-own-as-a-file"),
        (["store", "list", "{}"], "docs/runs.md#the-store"),
        (["demo", "--planner", "nonesuch", "--out", "{}/demo"], "docs/planners.md#built-in"),
        (["trellis", "verify", "{}"], "docs/image_to_3d.md#model-folders"),
        (["doctor", "--nonesuch"], None),
    ],
)
def test_an_error_names_the_page_that_helps(
    words: list[str], page: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([word.replace("{}", str(tmp_path)) for word in words]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.endswith(f"; see {page}") if page else "docs/" not in line
    assert len(line) <= LINE_LIMIT + len("recast: ")


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
    assert capsys.readouterr().err.rstrip().endswith("see docs/install.md#extras")
