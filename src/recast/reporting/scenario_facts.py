"""A scenario in numbers, before anything runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from recast.core.errors import printable
from recast.dynamics import state as ego
from recast.evaluation.collision import TOUCHING
from recast.geometry import boxes
from recast.simulation import PreparedRollout, RolloutSetup, ScriptedMotion, ego_centre
from recast.simulation.scenario import scenario_numbers
from recast.simulation.scenario_names import scenario_name
from recast.simulation.start_checks import ON_ROAD, on_road_shares, surveyed_road


@dataclass(frozen=True)
class ScenarioFacts:
    """What a scenario becomes at one place; metres, m/s, seconds after the start.

    Attributes:
        name: of the scenario.
        start: seconds after the first pose of the log.
        ego_speed: at the start.
        gap: along the route from the ego's front bumper to the actor's near end, at the start.
        actor_speeds: at the start, and at the end.
        laterals: of the actor beside the route, left positive, at the start, and at the end.
        meets_log: when the actor's box and that of the ego as recorded first overlap, or None.
        off_road: when less than half of the actor's box is on a surveyed map's road, or None.
        seconds, asked: how long the rollout can be at most, and was asked to be.
        cut_reason: why that is less, or None.
    """

    name: str
    start: float
    ego_speed: float
    gap: float
    actor_speeds: tuple[float, float]
    laterals: tuple[float, float]
    meets_log: float | None
    off_road: float | None
    seconds: float
    asked: float
    cut_reason: str | None


def scenario_facts(setup: RolloutSetup, prepared: PreparedRollout) -> ScenarioFacts:
    """Measure a prepared rollout."""
    actor, vehicle, size = prepared.actor, setup.vehicle, setup.track.size
    s, lateral = prepared.route.project(actor)
    logged = ego_centre(prepared.log_ego[:, :3], vehicle.centre_offset)
    overlap = boxes.bev_overlap_area(logged, (vehicle.length, vehicle.width), actor[:, :3], size)
    shares = on_road_shares(surveyed_road(setup.hdmap), actor[:, :3], size)
    bumper = float(prepared.route.project(prepared.ego)[0]) + vehicle.front_length
    first = setup.log.world_from_rig.timestamps_us[0]
    return ScenarioFacts(
        name=scenario_name(setup.motion),
        start=float(prepared.start_timestamp_us - first) * 1e-6,
        ego_speed=float(prepared.ego[ego.VX]),
        gap=float(s[0]) - size[0] / 2 - bumper,
        actor_speeds=(float(actor[0, 3]), float(actor[-1, 3])),
        laterals=(float(lateral[0]), float(lateral[-1])),
        meets_log=_first(overlap > TOUCHING, setup.dt),
        off_road=_first(shares < ON_ROAD, setup.dt),
        seconds=prepared.steps * setup.dt,
        asked=setup.steps * setup.dt,
        cut_reason=prepared.cut_reason,
    )


def facts_table(facts: Sequence[ScenarioFacts]) -> Table:
    """One row a scenario; `notes` says what does not fit into it."""
    table = Table(box=SIMPLE_HEAD, caption="contact: if the ego drove as recorded")
    for heading in ("scenario", "gap m", "actor m/s", "beside m", "contact", "rollout s"):
        table.add_column(heading, no_wrap=True)
    for one in facts:
        table.add_row(
            one.name,
            f"{one.gap:.1f}",
            _change(one.actor_speeds),
            _change(one.laterals),
            "never" if one.meets_log is None else f"{one.meets_log:.1f} s",
            f"{one.seconds:g} of {one.asked:g}",
        )
    return table


def notes(facts: Sequence[ScenarioFacts]) -> list[str]:
    """What cuts the rollouts, and whether an actor leaves the road, in sentences."""
    found: dict[str, list[str]] = {}
    for one in facts:
        if one.cut_reason is not None:
            found.setdefault(one.cut_reason, []).append(one.name)
        if one.off_road is not None:
            left = f"the actor leaves the drivable area {one.off_road:.1f} s after the start"
            found.setdefault(left, []).append(one.name)
    return [f"{', '.join(names)}: {sentence}" for sentence, names in found.items()]


def motions_table(motions: Sequence[ScriptedMotion]) -> Table:
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


def _first(true: np.ndarray, dt: float) -> float | None:
    steps = np.flatnonzero(true)
    return float(steps[0] * dt) if len(steps) else None


def _change(values: tuple[float, float]) -> str:
    first, last = (f"{value:.1f}".replace("-0.0", "0.0") for value in values)
    return first if first == last else f"{first} to {last}"
