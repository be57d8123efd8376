"""What commands print: tables for people, or one JSON list for programs.

The JSON of every command has one form: a list of objects. Each object is one row; its member
`table` names the table. Keys end in the unit (`download_gb`, `psnr_db`, `duration_s`); in a row
about one metric, `unit` holds it. Values are strings, booleans, finite numbers, null for unknown,
or lists of these.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

if TYPE_CHECKING:
    from rich.console import Console

Rows = Mapping[str, Iterable[Mapping[str, Any]]]
"""Rows by table name."""

JSON = tyro.conf.arg(
    help="Print the tables as one JSON list on standard output, and everything else on standard "
    "error."
)


def console_for(as_json: bool) -> Console:
    """The console for progress and messages: standard error if the output is JSON."""
    from rich.console import Console

    return Console(stderr=as_json)


def print_json(tables: Rows) -> None:
    """Print the rows of all tables as one JSON list.

    Args:
        tables: values of rows are plain, numpy or path-like; NaN and infinity become null.
    """
    rows = [
        {"table": name, **{key: _plain(value) for key, value in row.items()}}
        for name, table in tables.items()
        for row in table
    ]
    print(json.dumps(rows, indent=2, allow_nan=False))


def with_unit(name: str, unit: str) -> str:
    """The key of a quantity: its name, and its unit in words."""
    words = {"%": "percent", "dB": "db", "m/s": "mps", "m/s^2": "mps2", "of v_r": "of_v_r"}
    ending = words.get(unit, unit.lower())
    return f"{name}_{ending}" if ending else name


def _plain(value: Any) -> Any:
    if hasattr(value, "item") and not hasattr(value, "__len__"):  # numpy's numbers
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    return value
