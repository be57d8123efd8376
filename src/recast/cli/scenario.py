"""`recast scenario`: what the controlled actor does, seen before anything runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from recast.cli import shared
from recast.cli.output import JSON, console_for, print_json


@dataclass(frozen=True)
class ScenarioList:
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
class ScenarioShow:
    """Draw scenarios on the map of a log: start of the ego, path of the actor, end of the
    rollout."""

    log: tyro.conf.Positional[Path]
    """Log folder."""
    motion: Annotated[shared.Names, shared.required(shared.MOTION_HELP)]
    out: Path = Path("scenario.png")
    """Image to write (PNG)."""
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


Scenario = shared.group(
    "scenario",
    "List scenarios, draw them on a log before a run; recast-bridges exports and imports them.",
    {"list": ScenarioList, "show": ScenarioShow},
)
