"""The built site: what its search finds first, and that no page loads anything from elsewhere."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

import recast
from support.doc_blocks import REPOSITORY

pytestmark = pytest.mark.whole
ASKED = {
    "cut-in": "scenarios/",
    "cut in": "scenarios/",
    "oncoming": "scenarios/",
    "stationary": "scenarios/",
    "scenario": "scenarios/",
    "planner": "planners/",
    "gtrs-mini": "planners/",
    "recast-mini": "image_to_3d/",
    "arm": "runs/",
    "native": "runs/",
    "closed loop": "bench/",
    "search": "search/",
    "trust": "trust/",
    "limits": "limits/",
    "boundary": "search/",
    "gpu": "howto/gpu/",
    "install": "install/",
    "DrivingLog": "reference/api/recast.logs/",
}
"""The page that a search must show first."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", folder]
    subprocess.run(
        build, cwd=REPOSITORY, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, check=True
    )
    return folder


@pytest.mark.skipif(shutil.which("node") is None, reason="Node.js is not installed")
def test_the_search_shows_guides_first(site: Path) -> None:
    script = REPOSITORY / "tests" / "support" / "site_search.js"
    answer = subprocess.run(["node", script, site, *ASKED], stdout=subprocess.PIPE, check=True)
    pages = {
        query: [hits[0] for hits in found] for query, found in json.loads(answer.stdout).items()
    }
    first = {query: found[0].partition("#")[0] for query, found in pages.items()}
    assert first == ASKED
    assert any("recast.simulation.CutIn" in page for page in pages["cut-in"]), "not found at all"


def test_the_index_weighs_the_api_less(site: Path) -> None:
    """What the ranking rests on, where no JavaScript runs."""
    index = json.loads((site / "search" / "search_index.json").read_text())
    boosts = {"reference/api/": set(), "": set()}
    for entry in index["docs"]:
        kind = "reference/api/" if entry["location"].startswith("reference/api/") else ""
        boosts[kind].add(entry.get("boost", 1))
    assert boosts == {"reference/api/": {0.01}, "": {1}}
    tagged = {word: entry["location"] for entry in index["docs"] for word in entry.get("tags", ())}
    assert tagged["cut-in"].startswith("scenarios/")


class _Loads(HTMLParser):
    """Addresses that a browser loads with a page; links that a reader may follow are none."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        names = ("src", "srcset", "poster", "data") + (("href",) if tag in ("link", "use") else ())
        self.found += [str(given[name]) for name in names if name in given]


def test_no_page_loads_anything_from_elsewhere(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 70
    for page in pages:
        loads = _Loads()
        loads.feed(page.read_text())
        assert loads.found
        assert not [one for one in loads.found if re.match(r"(\w+:)?//", one)], page
    for style in site.rglob("*.css"):
        assert not re.search(r"(url\(['\"]?|@import ['\"]?)(https?:)?//", style.read_text()), style


def test_every_page_has_its_version_its_neighbours_and_a_dark_form(site: Path) -> None:
    for page in [site / "trust" / "index.html", site / "reference/api/recast.logs/index.html"]:
        text = page.read_text()
        assert f"recast {recast.__version__}" in text.split("md-copyright__highlight")[1]
        assert "md-footer__link--prev" in text and "md-footer__link--next" in text
        media = re.findall(r'data-md-color-media="([^"]+)"', text)
        assert "(prefers-color-scheme)" in media and "(prefers-color-scheme: dark)" in media
