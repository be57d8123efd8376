"""What commands print: tables for people, one JSON list for programs, and pages to errors.

The JSON of every command has one form: a list of objects. Each object is one row; its member
`table` names the table. Keys end in the unit (`download_gb`, `psnr_db`, `duration_s`); in a row
about one metric, `unit` holds it. Values are strings, booleans, finite numbers, null for unknown,
or lists of these.
"""

from __future__ import annotations

import json
import math
import re
import sys
import traceback
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from recast.core.errors import InputError, printable

if TYPE_CHECKING:
    from rich.console import Console

Rows = Mapping[str, Iterable[Mapping[str, Any]]]
"""Rows by table name."""

JSON = tyro.conf.arg(
    help="Print the tables as one JSON list on standard output, and everything else on standard "
    "error."
)
EXTRAS_PAGE = "docs/install.md#extras"

_VEHICLES = "docs/actors.md#bring-your-own-vehicle"
_SCENARIO_FILE = "docs/scenarios.md#your-own-as-a-file"

PAGES = {
    "recast.actors.axes": "docs/actors.md#axes",
    "recast.actors.library": "docs/actors.md#a-library-of-vehicles",
    "recast.actors.mesh": _VEHICLES,
    "recast.actors.vehicle_files": _VEHICLES,
    "recast.cli.rows.store": "docs/runs.md#the-store",
    "recast.core.artefact": "docs/runs.md#the-store",
    "recast.core.remote": "docs/runs.md#the-store",
    "recast.core.store": "docs/runs.md#the-store",
    "recast.metrics.trust": "docs/trust.md",
    "recast.logs": "docs/data.md#the-log-folder",
    "recast.logs.importers": "docs/data.md#what-can-be-read",
    "recast.runs.arm_words": "docs/runs.md#arms",
    "recast.runs.arms": "docs/runs.md#arms",
    "recast.studies.trust": "docs/trust.md#calibrate",
    "recast.runs.config": "docs/runs.md#a-configuration-file",
    "recast.runs.run_folder": "docs/runs.md#the-run-folder",
    "recast.planning": "docs/planners.md#your-own-planner",
    "recast.planning.registry": "docs/planners.md#built-in",
    "recast.simulation.renderer": "docs/runs.md#restored-images",
    "recast.recar": "docs/recar.md",
    "recast.scene.config": "docs/scenes.md#configuration",
    "recast.simulation.scenario_file": _SCENARIO_FILE,
    "recast.splats.cuda": "docs/rasterizer.md#on-a-gpu",
    "recast.synthetic": "docs/synthetic.md",
    "recast.trellis.checkpoints": "docs/image_to_3d.md#model-folders",
    "recast.weights": "docs/weights.md#names",
}
"""Page by module or package; the innermost package counts. Packages of plug-ins may have theirs in
an attribute `PAGES` of the outermost one."""


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


def line_of(error: InputError, command: object = None) -> str:
    """The error's line: settings in backquotes as options of the command, and the page that helps.

    Args:
        command: that was run; None if its words were not understood.
    """
    options: set[str] = set()
    while command is not None:
        options |= vars(command).keys()
        command = getattr(command, "command", None)

    def shown(match: re.Match[str]) -> str:
        return "--" + match[1].replace("_", "-") if match[1] in options else match[0]

    where, field, mend = (
        re.sub("`([a-z_]+)`", shown, text) for text in (error.where, error.field, error.mend)
    )
    return InputError(where, field, error.problem, mend).line(page_of(error))


def page_of(error: InputError) -> str | None:
    """The page to name after the error's line; None if there is none, or the line names one.

    An `InputError` may name its page. Other errors get the page of the part of recast that raised
    them: the innermost function with a page counts.
    """
    if error.page is not None or "docs/" in error.mend:
        return error.page
    if "recast-sim[" in error.mend:
        return EXTRAS_PAGE
    for frame, _ in reversed(list(traceback.walk_tb(error.__traceback__))):
        module = frame.f_globals.get("__name__", "") + "."
        package = sys.modules.get(module.partition(".")[0])
        pages = {**PAGES, **getattr(package, "PAGES", {})}
        matching = (name for name in pages if module.startswith(f"{name}."))
        found = max(matching, key=len, default=None)
        if found is not None:
            return str(pages[found])
    return None


def without_images(cameras: Sequence[str]) -> list[str]:
    """A line that names cameras of which a log has no image; none if there are none."""
    listed = ", ".join(map(printable, cameras))
    return [f"no images of {listed}: the log has their calibration only"] if listed else []
