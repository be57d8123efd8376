"""Pages that messages, help texts and comments of the code name: they and their headings exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from markdown.extensions.toc import slugify

from support.doc_blocks import REPOSITORY

FOLDERS = ("src", "tests", "examples", "benchmarks")
_NAMED = re.compile(r"\bdocs/[\w/]+\.md(?:#[\w-]+)?")


def headings(page: Path) -> set[str]:
    """Anchors of a page's headings, as MkDocs makes them."""
    text = re.sub(r"^ *```.*?^ *```$", "", page.read_text(), flags=re.M | re.S)
    return {
        slugify(re.sub(r"\[([^\]]*)\]\([^)]*\)|[`*]", r"\1", row), "-")
        for row in re.findall(r"^#+ (.*)", text, re.M)
    }


@pytest.mark.parametrize("folder", FOLDERS)
def test_named_pages_exist(folder: str) -> None:
    wrong, count = [], 0
    for source in (REPOSITORY / folder).rglob("*.py"):
        for name in set(_NAMED.findall(source.read_text())):
            page, _, anchor = name.partition("#")
            path, count = REPOSITORY / page, count + 1
            if not path.is_file() or (anchor and anchor not in headings(path)):
                wrong.append(f"{source.relative_to(REPOSITORY)}: {name}")
    assert not wrong, "\n".join(wrong)
    assert folder != "src" or count > 60


def test_anchors_are_those_of_the_headings() -> None:
    found = headings(REPOSITORY / "docs" / "runs.md")
    assert {"the-store", "a-configuration-file"} <= found and "version" not in found
