"""The page of limits: each of its figures is on a page that the same line links."""

from __future__ import annotations

import re

from recast.cli.docs import topic_text

_LINK = re.compile(r"\]\(([\w./]+\.md)[^)]*\)")


def test_every_figure_is_that_of_a_linked_page() -> None:
    """A line is a paragraph, an item of a list or a row of a table."""
    count = 0
    for line in re.split(r"\n\n|\n(?=[-|])", topic_text("limits")):
        linked = " ".join(topic_text(page) for page in _LINK.findall(line))
        figures = re.findall(r"\d+(?:\.\d+)?", _LINK.sub("]", line))
        missing = [one for one in figures if not re.search(rf"(?<![\d.]){one}(?![\d.]*\d)", linked)]
        assert not missing, line
        count += len(figures)
    assert count > 25
