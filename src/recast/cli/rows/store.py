"""The artefacts of a store: tables, explanations and removal, and rows of `recast store list`."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text
from rich.tree import Tree

from recast.cli.output import Rows
from recast.core import Artefact, Store, files
from recast.core.artefact import references
from recast.core.errors import InputError, printable

_DIGITS = 10
"""Of a key, as lists show it."""


def list_store(store: Store, console: Console) -> None:
    """Print a line for each artefact; InputError: there is no store, or one of another version."""
    users = store.users()
    table = Table(box=SIMPLE_HEAD, collapse_padding=True, pad_edge=False)
    for heading in ("kind", "key", "what"):
        table.add_column(heading, no_wrap=heading != "what")
    for heading in ("MB", "s", "runs"):
        table.add_column(heading, justify="right", no_wrap=True)
    total = 0
    for one in store.artefacts():
        used = sum(one.reference in names for names in users.values())
        total += one.size
        table.add_row(
            one.record.kind,
            one.record.key[:_DIGITS],
            Text(printable(one.record.name)),
            f"{one.size / 1e6:.1f}",
            f"{one.record.seconds:.0f}",
            str(used),
        )
    console.print(table)
    console.print(
        f"artefacts: {table.row_count}, {total / 1e6:.1f} MB; run folders: {len(users)}",
        highlight=False,
    )


def explain_artefact(place: str, key: str, console: Console) -> None:
    """Print the inputs of an artefact as a tree, with those of the artefacts among them.

    Raises:
        InputError: no artefact, or several, have this key.
    """
    store = opened_store(place)
    found = [one for one in store.artefacts() if key and one.record.key.startswith(key)]
    if len(found) != 1:
        problem = f"{len(found)} artefacts have this key" if found else "no artefact has this key"
        raise InputError(place, f"key {key}", problem, "give a whole key, see recast store list")
    console.print(_tree(store, found[0]))


def prune_store(place: str, remove: bool, older_than_h: float, console: Console) -> None:
    """Print what nobody needs, and remove it if that is wanted.

    Args:
        older_than_h: hours since an artefact was made; younger ones are left.

    Raises:
        InputError: there is no store, or the disk refuses.
    """
    store = opened_store(place)
    unused, leftovers = store.unused(3600.0 * older_than_h), store.leftovers()
    for one in unused:
        line = f"{one.record.kind} {one.record.key[:_DIGITS]} {one.record.name}"
        console.print(printable(line), markup=False, highlight=False)
        if remove:
            store.remove(one)
    for folder in leftovers:
        console.print(f"left behind: {folder.name}", markup=False, highlight=False)
        if remove:
            with files.disk_errors(folder):
                shutil.rmtree(folder)
    size = sum(one.size for one in unused) / 1e6
    verb = "removed" if remove else "can be removed with --yes"
    console.print(
        f"{len(unused)} artefacts ({size:.1f} MB) and {len(leftovers)} leftovers {verb}",
        highlight=False,
    )


def store_rows(store: Store) -> Rows:
    """One row for each artefact of a local store."""
    users = store.users().values()
    return {
        "artefacts": [
            {
                "kind": one.record.kind,
                "key": one.record.key,
                "name": one.record.name,
                "size_bytes": one.size,
                "making_s": one.record.seconds,
                "runs": sum(one.reference in names for names in users),
            }
            for one in store.artefacts()
        ]
    }


def opened_store(place: str) -> Store:
    """A local store that is there.

    Raises:
        InputError: it is elsewhere, or is none.
    """
    if "://" in place or not (Path(place) / "store.json").is_file():
        raise InputError(place, "store", "is not a local store", "name the folder of a store")
    return Store(place)


def _tree(store: Store, artefact: Artefact) -> Tree:
    record = artefact.record
    title = f"{record.kind} {record.key[:_DIGITS]}  {record.name}  ({record.seconds:.0f} s)"
    tree = Tree(Text(printable(title), style="bold"))
    for name, value in record.inputs.items():
        if next(references(value), None) is None:
            tree.add(Text(printable(f"{name}: {_short(value)}")))
            continue
        branch = tree.add(Text(printable(name)))
        for reference in references(value):
            try:
                inner = store.open(reference)
            except InputError as error:
                branch.add(Text(printable(f"{reference}: {error.problem}")))
                continue
            branch.add(_tree(store, inner))
    return tree


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 100 else f"{text[:99]}…"
