"""Pages that messages, help texts and comments name: they exist, and `recast docs` prints them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from markdown.extensions.toc import slugify

from recast.cli.docs import docs_pages, page_sections, topic_text
from recast.core.errors import InputError
from support.doc_blocks import REPOSITORY

FOLDERS = ("src", "bridges/src", "tools/src", "tests", "examples", "benchmarks")
_NAMED = re.compile(r"\b(?:docs/[\w/]+\.md|recast docs [\w/]+)(?:#[\w-]+)?")


def headings(page: Path) -> set[str]:
    """Anchors of a page's headings, by MkDocs' own function."""
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
            count += 1
            try:
                topic_text(name.removeprefix("recast docs "))
            except InputError as error:
                wrong.append(f"{source.relative_to(REPOSITORY)}: {error}")
    assert not wrong, "\n".join(wrong)
    assert folder != "src" or count > 60


def test_anchors_are_those_of_the_headings() -> None:
    for path in docs_pages().values():
        assert page_sections(path.read_text()).keys() == headings(path), path
    found = page_sections((REPOSITORY / "docs" / "runs.md").read_text())
    assert {"the-store", "a-configuration-file"} <= found.keys() and "version" not in found


def test_make_help_lists_every_target() -> None:
    text = (REPOSITORY / "Makefile").read_text()
    phony = re.findall(r"^\.PHONY: (.*)$", text, re.M)[0].replace("$(LEVELS:%=test-at-%)", "")
    listed = re.findall(r'^\t@echo "make (\S+) +(.*)"$', text, re.M)
    assert {name for name, _ in listed} == {*phony.split(), "test-at-LEVEL"} - {"help"}
    assert all(len(f"make {name:<14} {what}") <= 80 for name, what in listed)
