"""`recast scenario`: what the controlled actor does, seen before anything runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from recast.cli import shared
from recast.cli.output import JSON, console_for, print_json


@dataclass(frozen=True)
class List:
    """Print scenarios with their numbers, or check scenario files."""

    scenarios: tyro.conf.Positional[tuple[str, ...]] = ()
    """Scenarios such as cut-in-a, motions such as cut-in, or scenario files (.yaml); all built-in
    scenarios if none is named."""
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.cli.rows.scenario_list import list_scenarios, scenario_rows

        if self.json:
            print_json(scenario_rows(self.scenarios))
        else:
            list_scenarios(self.scenarios, console_for(False))


@dataclass(frozen=True)
class Show:
    """Draw scenarios on the map of a log: start of the ego, path of the actor, end of the
    rollout."""

    log: tyro.conf.Positional[Path]
    """Log folder."""
    motion: Annotated[shared.Names, shared.required(shared.MOTION_HELP)]
    out: Path = Path("scenario.png")
    """Picture to write (PNG)."""
    track: Annotated[
        str | None,
        shared.option(shared.TRACK_HELP, "target of a synthetic log, else the first track"),
    ] = None
    steps: Annotated[int, shared.STEPS] = 160
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.cli.rows.scenarios import place_scenarios, placed_rows, show_scenarios

        placed = place_scenarios(self.log, self.motion, self.track, self.steps)
        show_scenarios(placed, self.out, console_for(self.json))
        if self.json:
            print_json(placed_rows(placed))


@dataclass(frozen=True)
class Export:
    """Write scenarios on a log, or driven rollouts, as OpenSCENARIO XML with the map as OpenDRIVE;
    every file is read back and compared."""

    log: tyro.conf.Positional[Path]
    """Log folder."""
    out: Path
    """Folder to write; must not exist."""
    motion: Annotated[shared.Names, shared.option(shared.MOTION_HELP)] = ()
    rollout: Annotated[
        tuple[Path, ...],
        shared.option("Rollout folders of this log: RUN/rollouts/SCENARIO/PLANNER/ARM/states."),
    ] = ()
    track: Annotated[
        str | None,
        shared.option(shared.TRACK_HELP, "target of a synthetic log, else the first track"),
    ] = None
    steps: Annotated[int, shared.STEPS] = 160
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.cli.rows.openx import export_lines, export_rows, export_scenarios

        written = export_scenarios(
            self.log, self.out, self.motion, self.rollout, self.track, self.steps
        )
        console = console_for(self.json)
        for line in (*export_lines(*written), f"wrote {self.out}"):
            console.print(line, markup=False, highlight=False)
        if self.json:
            print_json(export_rows(*written))


@dataclass(frozen=True)
class Import:
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
        from recast.cli.rows.scenarios import import_lines, import_rows
        from recast.logs import read_log
        from recast.protocols.neuroncap import import_ncap_scenario

        log = read_log(self.log)
        written = import_ncap_scenario(self.path, log, self.out, self.runs, self.name)
        console = console_for(self.json)
        for line in import_lines(written, self.log):
            console.print(line, markup=False, highlight=False, soft_wrap=True)
        if self.json:
            print_json(import_rows(written))


Scenario = shared.group(
    "List scenarios, draw them on a log before a run, export them, or import others'.",
    {"list": List, "show": Show, "export": Export, "import": Import},
)
