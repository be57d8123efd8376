"""`recast docs`: every page and section that a message names, in 80 columns."""

from __future__ import annotations

import re

import pytest

from recast.cli.docs import docs_pages
from recast.cli.main import main
from support.doc_blocks import REPOSITORY
from support.terminal import in_terminal, plain


def test_topics_are_all_pages_of_the_repository(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["docs"]) == 0
    lines = capsys.readouterr().out.splitlines()
    pages = (REPOSITORY / "docs").rglob("*.md")
    names = {page.relative_to(REPOSITORY / "docs").with_suffix("").as_posix() for page in pages}
    assert {line.split()[0] for line in lines} == names == docs_pages().keys()
    assert "howto/ci" in names and max(map(len, lines)) <= 80


def test_no_page_is_wider_than_the_terminal() -> None:
    code = "from recast.cli.docs import docs_pages\nfrom recast.cli.main import main\n"
    code += "for name in docs_pages():\n    assert main(['docs', name]) == 0\n"
    ended, shown = in_terminal([], code=code, NO_COLOR="1")
    lines = plain(shown)
    assert ended == 0 and len(lines) > 5000
    assert [line for line in lines if len(line) > 80] == []


@pytest.mark.parametrize(
    "topic", ["runs#arms", "docs/runs.md#arms", "runs.md#arms", "../runs.md#arms"]
)
def test_a_section_ends_with_the_next_of_its_level(
    topic: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["docs", topic]) == 0
    text = capsys.readouterr().out
    assert text.split()[0] == "Arms" and "The run folder" not in text
    assert "noise-floor" in text and "Where artefacts lie" not in text


def test_a_page_of_a_folder_has_a_short_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["docs", "ci"]) == 0
    short = capsys.readouterr().out
    assert main(["docs", "howto/ci"]) == 0
    assert capsys.readouterr().out == short


@pytest.mark.parametrize(
    ("topic", "said"),
    [
        ("rnus", "rnus: is not a topic of the documentation; did you mean runs?"),
        ("qqq", "qqq: is not a topic of the documentation; run `recast docs` to list the topics"),
        ("runs#arm", "runs#arm: is not a section of this page; did you mean runs#arms?"),
        ("reference/command_line.md#recast-run", "is a page of the site alone; see recast --help"),
        ("runs#qqq", "run recast docs runs to read it"),
    ],
)
def test_an_unknown_topic_is_one_line(
    topic: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["docs", topic]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("recast: command line: ") and said in line


def test_an_error_ends_with_a_command_that_prints_its_page(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["weights", "path", "nonesuch"]) == 2
    found = re.search(r"; see recast (docs weights#names)$", capsys.readouterr().err)
    assert found and main(found[1].split()) == 0
    assert capsys.readouterr().out.split()[0] == "Names"
