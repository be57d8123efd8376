"""`recast docs`: the pages of the documentation in the terminal, by the names in messages."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from recast.cli.shared import console_for, option
from recast.core.errors import InputError, nearest

_TOPIC = option(
    "Page, or page and section, such as runs or runs#arms.", "list all pages", metavar="TOPIC"
)


@dataclass(frozen=True)
class Docs:
    """Print a page of the documentation or a section of it; without a topic, list the topics."""

    topic: Annotated[tyro.conf.Positional[str | None], _TOPIC] = None

    def __call__(self) -> None:
        from rich.markdown import Markdown
        from rich.table import Table

        console = console_for(False)
        if self.topic is not None:
            console.print(Markdown(_terminal_text(topic_text(self.topic)), hyperlinks=False))
            return
        table = Table.grid(padding=(0, 2))
        for name, path in docs_pages().items():
            table.add_row(name, path.read_text(encoding="utf-8").partition("\n")[0].lstrip("# "))
        console.print(table)


def docs_folder() -> Path | None:
    """Folder of the pages, in a wheel or in a checkout; None if it is missing."""
    package = Path(__file__).parents[1]
    folders = (package / "docs", package.parents[1] / "docs")
    return next((one for one in folders if one.is_dir()), None)


def docs_pages() -> dict[str, Path]:
    """File of each page by its topic, such as "runs" or "howto/ci"."""
    folder = docs_folder()
    if folder is None:
        raise InputError("documentation", "pages", "are not installed", "reinstall recast-sim")
    paths = sorted(folder.rglob("*.md"), key=lambda path: (path.parent, path.name))
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in paths}


def topic_text(topic: str) -> str:
    """Markdown of a page or section.

    Args:
        topic: such as "runs#arms", "ci" for "howto/ci", or as files and links name it:
            "docs/runs.md#arms", "../runs.md#arms".

    Raises:
        InputError: no page or section has this name.
    """
    page, _, anchor = topic.partition("#")
    name = re.sub(r"^(?:\.\./)*(?:docs/)?|\.md$", "", page)
    pages = docs_pages()
    path = {**{one.stem: one for one in pages.values()}, **pages}.get(name)
    if path is None and name.startswith("reference/"):  # made from the code, for the site
        problem, hint = "is a page of the site alone", "see recast --help for commands and options"
        raise InputError("command line", page, problem, hint)
    if path is None:
        alike = nearest(name, pages)
        hint = f"did you mean {alike}?" if alike else "run `recast docs` to list the topics"
        raise InputError("command line", page, "is not a topic of the documentation", hint)
    text = path.read_text(encoding="utf-8")
    if not anchor:
        return text
    sections = page_sections(text)
    if anchor not in sections:
        alike = nearest(anchor, sections)
        hint = f"did you mean {name}#{alike}?" if alike else f"run recast docs {name} to read it"
        raise InputError("command line", topic, "is not a section of this page", hint)
    return sections[anchor]


def page_sections(text: str) -> dict[str, str]:
    """Sections of a page with their subsections, by the anchors that the site gives them."""
    lines = text.splitlines()
    headings: list[tuple[int, int, str]] = []
    fenced = False
    for row, line in enumerate(lines):
        fenced ^= line.lstrip().startswith("```")
        if not fenced and (found := re.match(r"(#+) (.*)", line)):
            headings.append((row, len(found[1]), _anchor(found[2])))
    sections: dict[str, str] = {}
    for index, (row, level, anchor) in enumerate(headings):
        later = (end for end, other, _ in headings[index + 1 :] if other <= level)
        sections.setdefault(anchor, "\n".join(lines[row : next(later, len(lines))]))
    return sections


def _anchor(heading: str) -> str:
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)|[`*]", r"\1", heading)
    text = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", text).strip().lower())


def _terminal_text(text: str) -> str:
    """Markdown without what a terminal cannot show: images, and code of other files."""
    text = re.sub(r"!\[([^\]]*)\]\([^)]*\)", r"(image: \1)", text)
    return re.sub(r'^--8<-- "([^":]+).*"$', r"# see \1 in the repository", text, flags=re.M)
