"""What one rollout means for a search: how far it is from failing, and whether a driver could have
mastered its scenario."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from recast.arrays import Array
from recast.core.errors import InputError
from recast.dynamics import state as ego
from recast.geometry import boxes
from recast.metrics import COLUMNS, RolloutMetrics
from recast.metrics.driving import no_collision, no_collision_at_fault
from recast.metrics.rollout_metrics import least_gaps, rollout_actors
from recast.planning import ReferenceRoute
from recast.simulation import Rollout
from recast.simulation.rollout import ego_centre
from recast.simulation.rollout_start import StartingActor, along_route, start_rollout
from recast.simulation.running import run_rollout
from recast.simulation.setup import RolloutSetup

HARD = 6.0
"""m/s^2 that a driver brakes with at most: dry road, no hesitation."""
REACTION = 0.5
"""Seconds from when a driver can notice something to when the brakes bite."""


@dataclass(frozen=True)
class Objective:
    """What counts as a failure.

    Attributes:
        text: as the command line names it, such as "at-fault" or "ttc<1".
        measure: what is compared, one of `MEASURES` or of the columns of metrics.json.
        threshold: value from which on it fails; None for contacts.
        above: whether values above the threshold fail, instead of those below.
    """

    text: str
    measure: str
    threshold: float | None = None
    above: bool = False

    @property
    def unit(self) -> str:
        """Unit of the margin."""
        if self.threshold is None:
            return "m"
        return MEASURES[self.measure].unit if self.measure in MEASURES else ""

    def margin(self, metrics: RolloutMetrics) -> float | None:
        """How far a rollout is from failing: below 0 if it fails, None if that is not known.

        Without a contact, the least distance in metres; with one, minus the metres of braking with
        `HARD` that the relative speed at the contact stands for: both go through 0 where the
        boundary is.
        """
        if self.threshold is not None:
            value = measured(metrics).get(self.measure)
            if value is None:
                return None
            apart = value - self.threshold
            return -apart if self.above else apart
        if metrics.collision.first_step is None:
            return float(least_gaps(metrics.rollout).min())
        if self.measure == "at-fault" and metrics.nc_at_fault.value == 1.0:
            return 0.0
        speed = metrics.contact_speed or 0.0
        return -max(speed**2 / (2 * HARD), 1e-6)


def parse_objective(text: str, own: Sequence[str] = ()) -> Objective:
    """An objective as the command line names it.

    Args:
        own: names of own metrics.

    Raises:
        InputError: it is none; lists those there are.
    """
    if text in CONTACTS:
        return Objective(text, text)
    found = re.fullmatch(r"([a-z0-9_]+)([<>])([-+]?[0-9.]+(?:e[-+]?[0-9]+)?)", text)
    known = (*MEASURES, *(name for name in COLUMNS if name not in MEASURES), *own)
    if found is None or found[1] not in known:
        mend = f"choose {' or '.join(CONTACTS)}, or write NAME<VALUE of {', '.join(known)}"
        raise InputError("`objective`", text, "is not known", mend)
    return Objective(text, found[1], float(found[3]), found[2] == ">")


CONTACTS = ("at-fault", "collision")
"""Objectives without a threshold: a contact that the ego is to blame for, and any."""


@dataclass(frozen=True)
class _Measure:
    unit: str
    of: Callable[[RolloutMetrics], float | None]


def hardest_braking(rollout: Rollout) -> float:
    """Largest deceleration of the ego over half a second, m/s^2."""
    speed, span = rollout.ego[:, ego.VX], max(1, round(0.5 / rollout.dt))
    if len(speed) <= span:
        return float(max(0.0, speed[0] - speed[-1]) / (rollout.dt * (len(speed) - 1)))
    return float(max(0.0, (speed[:-span] - speed[span:]).max() / (span * rollout.dt)))


MEASURES: Mapping[str, _Measure] = {
    "distance": _Measure("m", lambda one: float(least_gaps(one.rollout).min())),
    "contact_speed": _Measure("m/s", lambda one: one.contact_speed or 0.0),
    "braking": _Measure("m/s^2", lambda one: hardest_braking(one.rollout)),
    "ttc": _Measure("s", lambda one: one.ttc.ttc.value),
}
"""What every trial keeps beside its margin, by name."""


def measured(metrics: RolloutMetrics) -> dict[str, float | None]:
    """`MEASURES` and the columns of metrics.json of a rollout, by name."""
    found = {name: metric.value for name, metric in metrics.values.items()}
    return found | {name: one.of(metrics) for name, one in MEASURES.items()}


# Whether a driver could have mastered it


LEVELS = np.arange(0.0, 12.01, 0.25)
"""Decelerations that are tried, m/s^2."""
_NOTICED_AHEAD = 1.0
"""Seconds for which a driver foresees where another vehicle goes, at its present velocity."""
_BESIDE = 0.3
"""Metres beside the ego's width that a driver watches."""
_COMFORT = 2.0
"""m/s^2 across the lane, at most, in a comfortable lane change."""


@dataclass(frozen=True)
class Difficulty:
    """What a scenario asks of an attentive driver.

    Who drives on at the speed of the start, notices the other vehicle as soon as that is on the
    way, or will be in 1 s at its velocity, and brakes `REACTION` later, or changes the lane.

    Attributes:
        noticed: seconds until the other vehicle can be noticed; None if it never is in the way.
        braking: m/s^2 that avoid the contact, at least; None if none of `LEVELS` does.
        lane_change: whether a comfortable change to the next lane avoids it.
    """

    noticed: float | None
    braking: float | None
    lane_change: bool

    @property
    def fair(self) -> bool:
        """Whether a driver masters it."""
        return self.lane_change or (self.braking is not None and self.braking <= HARD)

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {**vars(self), "fair": self.fair}


def difficulty(setup: RolloutSetup) -> Difficulty:
    """What a scenario asks of a driver, by arithmetic: no planner and no image takes part.

    Actors that react do so to an ego that keeps its speed.

    Raises:
        InputError: see `start_rollout`.
    """
    start = start_rollout(setup, setup.seed)
    times: Array = setup.dt * np.arange(start.steps + 1, dtype=np.float64)
    actors = _driven(setup, start.actors, start.steps)
    size = (setup.vehicle.length, setup.vehicle.width)
    speed = max(float(start.first[ego.VX]), 0.0)
    at_start = start.route.at_time(start.start_timestamp_us)
    s0, lateral = start.route.project(start.first, None if at_start is None else float(at_start))

    def to_blame(s: Array, beside: Array, speeds: Array) -> bool:
        """Whether an ego at these places, with these speeds, is to blame for a contact."""
        driven = np.zeros((len(s), len(ego.COLUMNS)))
        driven[:, ego.POSE], driven[:, ego.VX] = (
            start.route.pose(s, float(lateral) + beside),
            speeds,
        )
        own = ego_centre(driven[:, ego.POSE], setup.vehicle.centre_offset)
        hits = [no_collision(own, size, states, other, setup.dt) for states, other in actors]
        return no_collision_at_fault(hits, driven, [states for states, _ in actors]).value == 0.0

    constant: Array = float(s0) + speed * times
    noticed = _noticed(start.route, actors, constant, float(lateral), size[1])
    if noticed is None:
        return Difficulty(None, 0.0, False)
    begin = times[noticed] + REACTION
    late = np.maximum(times - begin, 0.0)
    needed = None
    for level in LEVELS:
        braked = np.minimum(late, speed / level) if level else late
        driven = speed * np.minimum(times, begin) + speed * braked - level * braked**2 / 2
        now = speed - level * braked
        if not to_blame(float(s0) + driven, np.zeros_like(times), now):
            needed = float(level)
            break
    beside = start.actors[0].situation.neighbour_lateral
    change = False
    if beside is not None and abs(beside) > 1e-3:
        # The quintic's largest acceleration is 5.77 times the way over the time squared.
        u = np.clip(late / np.sqrt(5.7735 * abs(beside) / _COMFORT), 0.0, 1.0)
        across = beside * u**3 * (10 - 15 * u + 6 * u**2)
        change = not to_blame(constant, across, np.full_like(times, speed))
    return Difficulty(float(times[noticed]), needed, change)


Driven = list[tuple[Array, Array]]
"""States (S+1, 4) and sizes (3,) of the controlled actors."""


def _driven(setup: RolloutSetup, actors: tuple[StartingActor, ...], steps: int) -> Driven:
    if not any(actor.reacts for actor in actors):
        return [(actor.states[: steps + 1], actor.track.size) for actor in actors]
    from recast.planning import ConstantVelocity

    rollout = run_rollout(setup, ConstantVelocity())
    found = [(one.states, one.size) for one in rollout_actors(rollout)]
    missing = steps + 1 - len(rollout.actor)  # a rollout that was cut: everybody stays there
    return [(np.concatenate([s, np.repeat(s[-1:], missing, 0)]), size) for s, size in found]


def _noticed(
    route: ReferenceRoute, actors: Driven, s: Array, lateral: float, width: float
) -> int | None:
    """The first step at which an actor is, or is about to be, on the ego's way before it."""
    half, first = width / 2 + _BESIDE, None
    ahead = _NOTICED_AHEAD * np.linspace(0.0, 1.0, 5)
    for states, size in actors:
        direction = np.stack([np.cos(states[:, 2]), np.sin(states[:, 2])], axis=-1)
        reach = states[:, None, :2] + ahead[:, None] * (states[:, 3:4] * direction)[:, None]
        headings = np.broadcast_to(states[:, None, 2:3], (*reach.shape[:2], 1))
        poses = np.concatenate([reach, headings], axis=-1).reshape(-1, 3)
        corners = boxes.bev_corners(poses, size[0], size[1]).reshape(-1, 2)
        near = along_route(route, states[:, :2], float(s[0]))
        along, beside = route.project(corners, np.repeat(near, len(ahead) * 4))
        along = along.reshape(len(s), len(ahead), 4)
        beside = beside.reshape(len(s), len(ahead), 4) - lateral
        inside = (beside.min(axis=-1) <= half) & (beside.max(axis=-1) >= -half)
        inside &= along.max(axis=-1) > s[:, None]
        steps = np.flatnonzero(inside.any(axis=1))
        if len(steps) and (first is None or steps[0] < first):
            first = int(steps[0])
    return first
