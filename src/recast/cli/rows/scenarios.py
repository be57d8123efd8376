"""Rows of `recast scenario list` and `recast scenario show`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from recast.cli.output import Rows, with_unit
from recast.errors import InputError
from recast.logs import map_of, read_log
from recast.reporting.scenario_facts import ScenarioFacts, scenario_facts
from recast.simulation import MOTIONS, RolloutSetup, parse_motions, prepare, scenario_name
from recast.simulation.scenario_parts import further_actors, target_motion
from recast.simulation.scenario_schema import MOTION_SCHEMAS, kind_of, motion_numbers


def scenario_rows(names: Sequence[str]) -> Rows:
    """One row for each scenario, and one for each further actor of a scenario.

    Raises:
        InputError: an unknown name or a faulty file.
    """
    motions = [motion for name in names for motion in parse_motions(name)]
    found, actors = [], []
    for motion in motions or list(MOTIONS.values()):
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


def placed_rows(log_path: Path, names: Sequence[str], track: str | None, steps: int) -> Rows:
    """One row for each scenario on a log; `refused` says why it cannot be run there.

    Args:
        log_path: log folder.
        names: scenarios, motions or scenario files.
        track: track to control; None for the target of a synthetic log, or the first track.
        steps: steps of 0.1 s of the rollout.
    """
    log = read_log(log_path)
    if track is None:
        track = log.metadata.get("target", next(iter(log.tracks)))
    hdmap = map_of(log)
    rows: list[dict[str, Any]] = []
    motions = {scenario_name(m): m for name in names for m in parse_motions(name)}
    for name, motion in motions.items():
        setup = RolloutSetup(log, track, motion, map=hdmap, steps=steps)
        try:
            facts = scenario_facts(setup, prepare(setup))
        except InputError as error:
            rows.append({"scenario": name, "track_id": track, "refused": str(error)})
            continue
        rows.append({"scenario": name, "track_id": track, "refused": None, **_facts(facts)})
    return {"scenarios": rows}


def _numbers(motion: Any) -> dict[str, Any]:
    kind = kind_of(motion)
    quantities = {} if kind is None else MOTION_SCHEMAS[kind].quantities
    numbers = motion_numbers(motion)
    return {
        "motion": kind or motion.name,
        **{with_unit(name, quantities[name].unit): value for name, value in numbers.items()},
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
