"""What all pages share: templates, and the folder that appears whole."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from recast import __version__
from recast.errors import InputError
from recast.reporting import palette, tables
from recast.reporting.assets import Assets
from recast.reporting.basics import NotMade
from recast.reporting.coverage_view import coverage_note
from recast.storage import atomic_folder, disk_errors, write_text

_GENERATOR = "recast report"


def write_page(out: str | Path, render: Callable[[Assets], str]) -> Path:
    """Write a folder with a page and its files; return its `index.html`.

    The folder appears whole; an earlier one at `out` is replaced.

    Args:
        out: the folder.
        render: makes the page, and the files that it shows.

    Raises:
        InputError: `out` holds something that is no report, or the disk is full.
    """
    out = Path(out)
    check_out(out)
    fresh = out.with_name(f".{out.name}.fresh")
    with disk_errors(out):
        if fresh.exists():  # left behind by a kill
            shutil.rmtree(fresh)
    with atomic_folder(fresh) as folder:
        write_text(folder / "index.html", render(Assets(folder)))
    with disk_errors(out):
        if out.exists():
            shutil.rmtree(out)
        fresh.rename(out)
    return out / "index.html"


def check_out(out: Path) -> None:
    """Refuse a folder that is neither empty nor a report.

    Raises:
        InputError: it is that.
    """
    if out.exists() and not _is_report(out):
        raise InputError(
            out, "report folder", "holds something that is no report", "name another folder"
        )


def render_template(name: str, **values: object) -> str:
    """Fill in a template; all values from outside are escaped."""
    environment = Environment(
        loader=PackageLoader("recast.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.tests["missing"] = lambda value: isinstance(value, NotMade)
    environment.filters["arm_colour"] = lambda i: palette.css(palette.arm_colour(i))
    environment.filters["coverage_note"] = coverage_note
    loader = environment.loader
    assert loader is not None

    def inline(file: str) -> Markup:
        return Markup(loader.get_source(environment, file)[0])

    environment.globals.update(
        share_colours={name: palette.css(colour) for name, colour in palette.SHARES.items()},
        zip=zip,
        markup=Markup,
        inline=inline,
        generator=f"{_GENERATOR} {__version__}",
        headings=tables.headings(),
    )
    return environment.get_template(name).render(values)


def _is_report(folder: Path) -> bool:
    page = folder / "index.html"
    if not page.is_file():
        return folder.is_dir() and not any(folder.iterdir())
    return f'content="{_GENERATOR}' in page.read_text(encoding="utf-8", errors="replace")[:2000]
