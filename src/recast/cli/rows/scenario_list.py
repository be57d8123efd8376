"""Scenarios with their numbers, as `recast scenario list` shows them; imports no torch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from recast.cli.output import Rows, with_unit
from recast.core.errors import printable
from recast.simulation import MOTIONS, ScriptedMotion, parse_motions, scenario_name
from recast.simulation.scenario import (
    MOTION_SCHEMAS,
    further_actors,
    kind_of,
    motion_numbers,
    scenario_numbers,
    target_motion,
)


def scenario_rows(names: Sequence[str]) -> Rows:
    """One row for each scenario, and one for each further actor of a scenario.

    Raises:
        InputError: an unknown name or a faulty file.
    """
    found, actors = [], []
    for motion in _motions(names):
        name = scenario_name(motion)
        found.append(
            {
                "scenario": name,
                "description": motion.description,
                **_numbers(target_motion(motion)),
            }
        )
        actors += [
            {"scenario": name, "track_id": actor.track_id, **_numbers(actor.motion)}
            for actor in further_actors(motion)
        ]
    return {"scenarios": found, "further_actors": actors}


def list_scenarios(names: Sequence[str], console: Console) -> None:
    """Print the scenarios that names and files stand for; where none is given, all built in.

    Raises:
        InputError: an unknown name or a faulty file.
    """
    console.print(_table(_motions(names)))


def _motions(names: Sequence[str]) -> list[ScriptedMotion]:
    """What names and files stand for; all that are built in if none is given."""
    return [one for name in names for one in parse_motions(name)] or list(MOTIONS.values())


def _table(motions: Sequence[ScriptedMotion]) -> Table:
    """Scenarios with their numbers and units, one a row."""
    table = Table(box=SIMPLE_HEAD)
    for heading in ("scenario", "numbers", "what happens"):
        table.add_column(heading)
    for motion in motions:
        numbers = scenario_numbers(motion)
        # as text: a description is no markup
        table.add_row(
            scenario_name(motion), "\n".join(numbers), Text(printable(motion.description))
        )
    return table


def _numbers(motion: Any) -> dict[str, Any]:
    kind = kind_of(motion)
    quantities = {} if kind is None else MOTION_SCHEMAS[kind].quantities
    numbers = motion_numbers(motion)
    return {
        "motion": kind or motion.name,
        **{with_unit(name, quantities[name].unit): value for name, value in numbers.items()},
    }
