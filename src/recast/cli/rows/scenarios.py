"""Scenarios with their numbers, and scenarios on a log, looked at before anything runs.

A list of scenarios needs no torch: what places them on a log is imported when it is used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from recast.cli.shared import Rows, with_unit
from recast.core import files
from recast.core.errors import InputError, printable
from recast.simulation import MOTIONS, ScriptedMotion, parse_motions, scenario_name
from recast.simulation.scenario import (
    MOTION_SCHEMAS,
    further_actors,
    kind_of,
    motion_numbers,
    scenario_numbers,
    target_motion,
)

if TYPE_CHECKING:
    from recast.logs import DrivingLog
    from recast.reporting.scenario_preview import ScenarioFacts
    from recast.simulation import PreparedRollout, RolloutSetup


def scenario_rows(names: Sequence[str]) -> Rows:
    """One row for each scenario, and one for each further actor of a scenario.

    Raises:
        InputError: an unknown name or a faulty file.
    """
    found, actors = [], []
    for motion in _motions(names):
        name = scenario_name(motion)
        found.append(
            {"scenario": name, "description": motion.description, **_numbers(target_motion(motion))}
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


@dataclass(frozen=True)
class PlacedScenario:
    """A scenario on a log; why it cannot be run there, or what it becomes.

    Attributes:
        shown: setup, prepared rollout and facts; None if it is refused.
    """

    name: str
    track: str
    refused: InputError | None
    shown: tuple[RolloutSetup, PreparedRollout, ScenarioFacts] | None = None


def place_scenarios(
    log_path: Path, names: Sequence[str], track: str | None, steps: int
) -> list[PlacedScenario]:
    """Prepare scenarios on a log.

    Args:
        track: track to control; None for the target of a synthetic log, or the first track.
    """
    from recast.logs import map_of, read_log
    from recast.reporting.scenario_preview import scenario_facts
    from recast.simulation import RolloutSetup, prepare

    motions = {scenario_name(m): m for name in names for m in parse_motions(name)}
    log = read_log(log_path)
    track = target_of(log) if track is None else track
    hdmap, found = map_of(log), []
    for name, motion in motions.items():
        setup = RolloutSetup(log, track, motion, map=hdmap, steps=steps)
        try:
            prepared = prepare(setup)
        except InputError as error:
            found.append(PlacedScenario(name, track, error))
            continue
        found.append(
            PlacedScenario(name, track, None, (setup, prepared, scenario_facts(setup, prepared)))
        )
    return found


def placed_rows(placed: Sequence[PlacedScenario]) -> Rows:
    """One row for each scenario on a log; `refused` says why it cannot be run there."""
    return {
        "scenarios": [
            {
                "scenario": one.name,
                "track_id": one.track,
                "refused": None if one.refused is None else str(one.refused),
                **({} if one.shown is None else _facts(one.shown[2])),
            }
            for one in placed
        ]
    }


def _facts(facts: ScenarioFacts) -> dict[str, Any]:
    return {
        "start_s": facts.start,
        "ego_speed_mps": facts.ego_speed,
        "gap_m": facts.gap,
        "actor_speed_start_mps": facts.actor_speeds[0],
        "actor_speed_end_mps": facts.actor_speeds[1],
        "lateral_start_m": facts.laterals[0],
        "lateral_end_m": facts.laterals[1],
        "contact_s": facts.meets_log,
        "off_road_s": facts.off_road,
        "rollout_s": facts.seconds,
        "asked_s": facts.asked,
        "cut_reason": facts.cut_reason,
    }


def show_scenarios(placed: Sequence[PlacedScenario], out: Path, console: Console) -> None:
    """Draw scenarios on a log's map into a PNG, and print what they become there.

    Raises:
        InputError: `out` is no PNG, every scenario is refused on this log, or the disk refuses.
    """
    from PIL import Image

    from recast.reporting.scenario_preview import draw_scenarios, facts_table, notes

    if out.suffix.lower() != ".png":
        raise InputError(out, "--out", "is not a PNG", "end its name in .png")
    for one in placed:
        if one.refused is not None:
            console.print(f"{one.name}: refused: {one.refused}", markup=False, style="yellow")
    shown = [one.shown for one in placed if one.shown is not None]
    if not shown and placed[0].refused is not None:
        raise placed[0].refused
    facts = [facts for _, _, facts in shown]
    console.print(
        f"track {printable(placed[0].track)}; start {facts[0].start:.1f} s after the log's first "
        f"pose, ego {facts[0].ego_speed:.1f} m/s",
        markup=False,
        highlight=False,
    )
    console.print(facts_table(facts))
    for note in notes(facts):
        console.print(note, markup=False, highlight=False)
    with files.atomic_file(out) as partial:
        Image.fromarray(draw_scenarios(shown)).save(partial, format="PNG")
    console.print(f"wrote {out}", markup=False)


def target_of(log: DrivingLog) -> str:
    """The track that is controlled if none is named.

    Raises:
        InputError: the log has no tracks.
    """
    if not log.tracks:
        raise InputError(log.name, "tracks", "are missing", "use a log with labelled vehicles")
    target = log.metadata.get("target", "")
    return target if target in log.tracks else next(iter(log.tracks))
