"""`recast scenario import`: scenario files of NeuroNCAP."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from recast.cli import shared
from recast.cli.output import JSON, Rows, console_for, print_json

if TYPE_CHECKING:
    from recast_bridges.neuroncap import ImportedFile


@dataclass(frozen=True)
class ScenarioImport:
    """Read a scenario file of NeuroNCAP and write its random runs as scenario files, one for each
    vehicle that is the target of some of them."""

    layout: tyro.conf.Positional[Literal["neuroncap"]]
    """Format of the file."""
    path: tyro.conf.Positional[Path]
    """Scenario file (YAML), such as scenarios/side/0103.yaml."""
    log: Annotated[Path, shared.required("Log folder of the nuScenes scene of the scenario.")]
    out: Path
    """Folder to write; must not exist."""
    runs: int = 10
    """Number of runs, at most 100. Their seeds are 0, 1, ..., as in NeuroNCAP."""
    name: Annotated[
        str | None,
        shared.option(
            "What the names of the scenarios begin with.", "names of the file and its folder"
        ),
    ] = None
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.logs import read_log
        from recast_bridges.neuroncap import import_ncap_scenario

        log = read_log(self.log)
        written = import_ncap_scenario(self.path, log, self.out, self.runs, self.name)
        console = console_for(self.json)
        for line in import_lines(written, self.log):
            console.print(line, markup=False, highlight=False, soft_wrap=True)
        if self.json:
            print_json(import_rows(written))


def import_lines(written: Sequence[ImportedFile], log_path: Path) -> list[str]:
    """What was written, and the command that runs each file."""
    lines = []
    for one in written:
        runs = ", ".join(map(str, one.seeds))
        lines.append(f"{one.path}: runs {runs}; target {one.target}")
        lines.append(
            f"  recast run {log_path} --track {one.target} --motion {one.path} "
            f"--steps {one.steps} --out RUN"
        )
    return lines


def import_rows(written: Sequence[ImportedFile]) -> Rows:
    """One row for each file."""
    rows = [
        {"file": one.path, "track_id": one.target, "runs": list(one.seeds), "steps": one.steps}
        for one in written
    ]
    return {"scenarios": rows}
