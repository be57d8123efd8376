"""Published weights on the console: the table, a download, the check of every byte."""

from __future__ import annotations

import sys

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    DownloadColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)
from rich.table import Table

from recast.errors import InputError
from recast.weights import PUBLISHED, Weights, published, weights_folder
from recast.weights.fetch import fetch, is_whole
from recast.weights.place import is_fetched
from recast.weights.record import read_weights_record, verify


def weights_table() -> Table:
    """All entries of the table, and which of them are here; made to fit 80 columns."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 1, 0))
    for title in ("name, options", "for, licence, commits", "GB"):
        table.add_column(title, overflow="fold", justify="right" if title == "GB" else "left")
    for name, weights in PUBLISHED.items():
        here = is_fetched(name)
        pins = "pinned by recast" if weights.pinned else "pinned on first use"
        licences = "; ".join(one.name for one in weights.licences)
        lines = [weights.use, licences + (" (to accept)" if weights.restricted else ""), pins]
        if here:
            record = read_weights_record(weights_folder(name))
            lines += [f"{where} {commit}" for where, commit in record.revisions.items()]
        first = "\n".join((name, *weights.options, "here" if here else "not here"))
        table.add_row(escape(first), escape("\n".join(lines)), f"{weights.gigabytes:.3g}")
    return table


def get_weights(name: str, accepted: bool, console: Console) -> None:
    """Show the licences, ask for consent where it is needed, and fetch.

    Args:
        accepted: consent from the command line; else a terminal is asked.

    Raises:
        InputError: see `fetch`.
    """
    weights = published(name)
    folder = weights_folder(name)
    if is_whole(weights, folder):
        path = fetch(weights)
        console.print(f"{name} is here: {path}", markup=False, soft_wrap=True)
        return
    for source in weights.sources:
        console.print(
            f"{source.where}: {source.licence.name}, {source.licence.link}",
            markup=False, highlight=False, soft_wrap=True,
        )  # fmt: skip
    if weights.restricted and not accepted and sys.stdin.isatty():
        accepted = console.input("accept these terms? [y/N] ", markup=False).strip().lower() == "y"
    columns = (
        TextColumn("{task.description}", markup=False), BarColumn(), DownloadColumn(),
        TransferSpeedColumn(), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True) as bars:
        tasks: dict[str, int] = {}

        def progress(file: str, came: int, of: int | None) -> None:
            if file not in tasks:
                tasks[file] = bars.add_task(file, total=of)
            bars.update(tasks[file], completed=came, visible=came != of)  # type: ignore[arg-type]

        path = fetch(weights, accepted=accepted, progress=progress)
    console.print(_told(weights, f"fetched to {path}"), markup=False, soft_wrap=True)


def verify_weights(name: str | None, console: Console) -> None:
    """Read every byte of fetched weights.

    Args:
        name: of an entry; None for all that are here.

    Raises:
        InputError: no such entry, not here, or the first file at fault; the others are checked too.
    """
    names = [name] if name else [one for one in PUBLISHED if is_fetched(one)]
    faults: list[InputError] = []
    for one in names:
        weights, folder = published(one), weights_folder(one)
        try:
            if not is_fetched(one):
                get = f"run `recast weights get {one}`"
                raise InputError("weights", one, "are not here", get)
            verify(folder, read_weights_record(folder))
            told = _told(weights, "as fetched")
        except InputError as error:
            faults.append(error)
            told = f"{one}: {error}"
        console.print(told, markup=False, highlight=False, soft_wrap=True)
    if faults:
        raise faults[0]
    if not names:
        console.print(f"no weights in {weights_folder()}", markup=False, soft_wrap=True)


def _told(weights: Weights, what: str) -> str:
    record = read_weights_record(weights_folder(weights.name))
    return f"{weights.name}: {len(record.files)} files, {record.size / 1e9:.2f} GB, {what}"
