"""What is refused: routes off the map, actors off the road or inside the ego, bad motions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from recast.arrays import Array
from recast.core.errors import InputError
from recast.geometry import boxes
from recast.logs.checks import WORLD_REACH
from recast.logs.hdmap import HdMap, drivable_region
from recast.logs.types import Track
from recast.planning import ReferenceRoute
from recast.simulation.actor_motion import (
    ActorMotion,
    BaseMotion,
    ScriptMotion,
    StartSituation,
)
from recast.simulation.rollout import PATH_COLUMNS, ego_centre
from recast.simulation.setup import RolloutSetup

ON_ROAD = 0.5
"""Share of the actor's box that must lie on the drivable area."""
_ROUTE_ON_MAP = 0.5
_TOLERANCE = 0.3
"""Metres beside the drivable area that still count as on the map, as in the metric DAC."""
_TOUCHING = 1e-9
_SCRIPT_MEND = "correct the script; see docs/scenarios.md#your-own-in-python"
_STEP_MEND = "return x, y, heading, speed >= 0; see docs/scenarios.md#your-own-in-python"


def refuse_starts(
    setup: RolloutSetup,
    road: shapely.Geometry | None,
    ego: Array,
    actors: Sequence[tuple[Track, BaseMotion, Array]],
) -> None:
    """Refuse controlled actors that overlap the ego or each other, or stand beside the road.

    Args:
        road: road from `surveyed_road`. An actor that follows its own logged path was recorded
            where it stands, so it is not refused by a map.
        ego: (11,) first state of the ego.
        actors: track, motion and (3,) first pose of the box centre, the target first.

    Raises:
        InputError: names the actors at fault.
    """
    vehicle = setup.vehicle
    placed = [("ego", ego_centre(ego[:3], vehicle.centre_offset), (vehicle.length, vehicle.width))]
    for track, motion, pose in actors:
        target = track.track_id == setup.track_id
        name, fault = "actor" if target else f"actor {track.track_id}", None
        for other, there, size in placed:
            overlap = boxes.bev_overlap_area(there, size, pose, track.size)
            if overlap > _TOUCHING:
                fault = f"{name} and {other} overlap by {overlap:.2f} m2 at the start"
                break
        share = 1.0 if motion.follows_log else float(on_road_shares(road, pose, track.size))
        if fault is None and share < ON_ROAD:
            who = "the actor" if target else name
            box = f"{share:.0%} of its box lies on the drivable area"
            fault = f"{who} would start off the road: {box}"
        if fault is not None:
            mend = "choose another start, motion or setting"
            raise InputError(setup.log.name, f"rollout {setup.name}", fault, mend)
        placed.append((name, pose, tuple(track.size)))


def surveyed_road(hdmap: HdMap | None) -> shapely.Geometry | None:
    """Drivable area and lanes of a surveyed map; None without one.

    A derived map is made from the drive and ends where the drive saw nothing: nothing is refused
    by it.
    """
    region = None if hdmap is None or hdmap.derived else drivable_region(hdmap)
    if region is not None:
        shapely.prepare(region)
    return region


def refuse_off_map(
    setup: RolloutSetup, road: shapely.Geometry | None, route: ReferenceRoute, start: float
) -> None:
    """Refuse a map that is not of this drive.

    Args:
        road: road from `surveyed_road`; None refuses nothing.
        start: route coordinate from which the route is looked at, metres.

    Raises:
        InputError: less than half of what is left of the route lies on the map.
    """
    if road is None:
        return
    s = np.linspace(min(start, route.length), route.length, 200)
    distance = shapely.distance(road, shapely.points(route.line.position(s)))
    share = float(np.mean(distance <= _TOLERANCE))
    if share < _ROUTE_ON_MAP:
        problem = f"only {share:.0%} of the ego's route lies on the map"
        mend = "use a map of this drive, in the world frame of the log"
        raise InputError(setup.log.name, f"rollout {setup.name}", problem, mend)


def on_road_shares(road: shapely.Geometry | None, actor: Array, actor_size: Array) -> Array:
    """Share (...) of boxes (..., 3) that lies on the road; 1 where that is None."""
    if road is None:
        return np.ones(actor.shape[:-1])
    outlines = shapely.polygons(boxes.bev_corners(actor, actor_size[0], actor_size[1]))
    covered: Array = shapely.area(shapely.intersection(outlines, road))
    return covered / shapely.area(outlines)


def checked_script(
    motion: ScriptMotion, situation: StartSituation, steps: int, dt: float, where: str
) -> Array:
    """A motion's states (steps + 1, 4).

    Raises:
        InputError: the script is not made of states; names the motion, the step and the value.
    """
    actor = np.asarray(motion.script(situation, steps, dt))
    expected, problem = (steps + 1, len(PATH_COLUMNS)), None
    if actor.shape != expected or actor.dtype.kind not in "iuf":
        problem = f"its script returned {actor.dtype} {actor.shape}, not numbers {expected}"
    elif not (np.abs(actor) <= WORLD_REACH).all():  # also NaN
        step = int(np.argmin((np.abs(actor) <= WORLD_REACH).all(axis=1)))
        problem = f"its state {step} is {actor[step].tolist()}"
    elif (actor[:, 3] < 0).any():
        problem = f"its speed is negative in state {int(np.argmax(actor[:, 3] < 0))}"
    if problem is not None:
        raise InputError(where, f"motion {motion.name}", problem, _SCRIPT_MEND)
    return actor.astype(np.float64)


def checked_state(motion: ActorMotion, value: object, step: int, where: str) -> Array:
    """A state (4,) that a motion's `start` or `step` returned.

    Args:
        step: step of the state, 0 at the start.

    Raises:
        InputError: it is no state; names the motion, the step and the value.
    """
    try:
        state = np.asarray(value)
    except ValueError:  # nested lists of different lengths
        state = np.asarray(None)
    fault = None
    if state.dtype.kind not in "iuf" or state.shape != (len(PATH_COLUMNS),):
        shown = f"{state.dtype} {state.shape}" if isinstance(value, np.ndarray) else f"{value!r}"
        fault = f"is {shown[:80]}, not numbers ({len(PATH_COLUMNS)},)"
    elif not (np.abs(state) <= WORLD_REACH).all():  # also NaN
        fault = f"is {state.tolist()}"
    elif state[3] < 0:
        fault = f"has the negative speed {state[3]:g}"
    if fault is not None:
        raise InputError(where, f"motion {motion.name}", f"its state {step} {fault}", _STEP_MEND)
    return state.astype(np.float64)
