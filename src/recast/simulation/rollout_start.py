"""Everything about a rollout that is fixed before the planner speaks: start, scripts, cuts."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.foreign import ForeignCode, read_only
from recast.dynamics import initial_state
from recast.dynamics import state as ego
from recast.geometry import boxes
from recast.geometry.boxes import TOUCHING
from recast.geometry.se2 import REACH
from recast.logs.checks import WORLD_REACH
from recast.logs.hdmap import HdMap, drivable_region
from recast.logs.types import PEOPLE, Track
from recast.planning import ReferenceRoute
from recast.simulation.actor_motion import (
    EGO,
    ActorMotion,
    BaseMotion,
    BaseScript,
    ScriptMotion,
    StartSituation,
    neighbour_lateral,
)
from recast.simulation.recorded_road import (
    Ending,
    RecordedRoad,
    RoadSurface,
    refuse_if_too_short,
    who,
)
from recast.simulation.rollout import PATH_COLUMNS, ego_centre
from recast.simulation.scenario import start_after
from recast.simulation.setup import RolloutSetup
from recast.simulation.traffic import ELSEWHERE, YieldingTraffic, traffic_of

_MIN_START_SPEED = 3.0
_STRETCH = 10
"""Times `REACH` before and ahead of the ego that an actor's place is looked for first."""
_BESIDE = 10.0
"""Metres beside the route within which an actor is on that stretch: two lanes and the verge."""


@dataclass(frozen=True)
class StartingActor:
    """A controlled actor before the first step.

    Attributes:
        track: the actor's track in the log.
        motion: what it does.
        situation: situation in which the motion starts.
        road: recorded road, on which it may be; None for traffic, which may come and go.
        states: (S+1, 4) its script; (1, 4) its first state if it reacts.
        world_from_actor: (S+1, 4, 4) or (1, 4, 4), the same in space.
        code: guard of calls of the motion.
        in_space: gives `world_from_actor` (4, 4) of the state that the motion gave last; None: that
            is found on the road's surface.
    """

    track: Track
    motion: BaseMotion
    situation: StartSituation
    road: RecordedRoad | None
    states: Array
    world_from_actor: Array
    code: ForeignCode
    in_space: Callable[[], Array] | None = None

    @property
    def reacts(self) -> bool:
        """Whether it has no script."""
        return not isinstance(self.motion, BaseScript)


@dataclass(frozen=True)
class RolloutStart:
    """The start of a rollout; the same for every planner, and for every arm but for `first`.

    Attributes:
        route, surface: the road.
        start_timestamp_us: log time of state 0.
        ego: (S+1, 11) logged ego states.
        first: (11,) the simulated ego's first state: the logged one, or beside it, see
            `RolloutSetup.start_left`.
        actors: the controlled ones, the target first, then the traffic.
        steps: S, which log and scripts allow; the ego and actors that react may leave the road
            earlier.
        ending, cut_reason: why S is what it is; the reason is None if S is what was asked for.
    """

    route: ReferenceRoute
    surface: RoadSurface
    start_timestamp_us: int
    ego: Array
    first: Array
    actors: tuple[StartingActor, ...]
    steps: int
    ending: Ending
    cut_reason: str | None


def start_rollout(setup: RolloutSetup, seed: int = 0) -> RolloutStart:
    """Find the start, script the actors, and cut what the recorded road does not carry.

    Args:
        seed: seed for motions that draw random numbers.

    Raises:
        InputError: no such track; no route; a start outside the log; a route off the map; a
            controlled actor overlaps the ego or another one at the start, or stands off the
            recorded road or the map's; less than two plan cycles remain; a motion's script is not
            made of states.
    """
    tracks = {track_id: setup.track_of(track_id) for track_id in setup.controlled}
    log, hdmap = setup.log.world_from_rig, setup.hdmap
    route = ReferenceRoute.from_trajectory(log)
    surface = RoadSurface.from_log(log, route, None if hdmap is None else hdmap.ground)
    start_us = _start(setup)
    state = initial_state(log.timestamps_us, log.poses, start_us, setup.vehicle)

    recorded = int((log.timestamps_us[-1] - start_us) // round(setup.dt * 1e6))
    steps, ending, reason = setup.steps, Ending.STEPS, None
    if recorded < steps:
        steps, ending = recorded, Ending.LOG
        reason = f"the log ends {recorded * setup.dt:.1f} s after the start"
    refuse_if_too_short(setup, steps, reason)

    target = _situation(setup, route, state, start_us, seed)
    road = surveyed_road(hdmap)
    refuse_off_map(setup, road, route, target.ego_s)
    actors = [
        _begin(setup, setup.controlled[track_id], track, target)
        for track_id, track in tracks.items()
    ]
    for actor in actors:
        assert actor.road is not None  # these are no traffic
        path = actor.states[: steps + 1, :2]
        s = along_route(route, path, target.ego_s)
        outside = actor.road.outside(path, s)
        if np.any(outside):
            steps, ending = int(np.argmax(outside)) - 1, Ending.ACTOR
            name = who(setup, actor.track.track_id)
            reason = actor.road.reason(name, path[steps + 1], float(s[steps + 1]))
            refuse_if_too_short(setup, steps, reason)
    first = ego.moved_left(state, setup.start_left) if setup.start_left else state
    refuse_starts(setup, road, first, [(a.track, a.motion, a.states[0, :3]) for a in actors])
    times = start_us + round(setup.dt * 1e6) * np.arange(steps + 1)
    actors += _traffic(setup, target, times, state, first, actors)

    logged = [initial_state(log.timestamps_us, log.poses, int(t), setup.vehicle) for t in times]
    return RolloutStart(
        route=route,
        surface=surface,
        start_timestamp_us=start_us,
        ego=np.stack(logged),
        first=first,
        actors=tuple(_lifted(actor, surface, steps) for actor in actors),
        steps=steps,
        ending=ending,
        cut_reason=reason,
    )


def along_route(route: ReferenceRoute, path: Array, ego_s: float) -> Array:
    """Route coordinates (T,) of an actor's places (T, 2): the first one on the stretch about the
    ego, if it is beside that."""
    stretch = ego_s + REACH * np.arange(-_STRETCH, _STRETCH + 1)
    stretch = stretch[(stretch >= 0.0) & (stretch <= route.length)]
    first = float(route.project(path[0])[0])
    if len(stretch):
        s, lateral = route.project(np.broadcast_to(path[0], (len(stretch), 2)), stretch)
        best = int(np.argmin(np.abs(lateral)))
        if abs(lateral[best]) <= _BESIDE:
            first = float(s[best])
    return route.follow(path, first)


def _begin(
    setup: RolloutSetup, motion: BaseMotion, track: Track, target: StartSituation
) -> StartingActor:
    situation = read_only(
        replace(target, actor_size=track.size, track_id=track.track_id, trajectory=track.trajectory)
    )
    code = ForeignCode(f"motion {motion.name}", target.seed, motion)
    with code.call("start"):
        if isinstance(motion, BaseScript):
            # In full: a motion must not depend on where it is cut.
            states = checked_script(motion, situation, setup.steps, setup.dt, setup.log.name)
        else:
            states = checked_state(motion, motion.start(situation), 0, setup.log.name)[None]
    own = track.trajectory.poses[:, :2, 3] if motion.follows_log else None
    road = RecordedRoad(situation.route, setup.road_margin, own)
    return StartingActor(track, motion, situation, road, states, np.zeros((0, 4, 4)), code)


def _traffic(
    setup: RolloutSetup,
    target: StartSituation,
    times: NDArray[np.int64],
    logged: Array,
    first: Array,
    actors: Sequence[StartingActor],
) -> list[StartingActor]:
    """The traffic, see `recast.simulation.traffic`.

    A track whose box lies on the ego in the log itself is left out with a warning, and so is one
    that is not labelled yet and whose continuation would begin in another road user: labels of one
    vehicle may be torn into two tracks.

    Args:
        target: situation of the target.
        times: (S+1,) log times of the rollout's states.
        logged, first: (11,) first state of the ego, as logged and as simulated.
        actors: the actors of the scenario.

    Raises:
        InputError: the ego or an actor of the scenario starts where a labelled track stands.
    """
    vehicle, start_us = setup.vehicle, target.start_timestamp_us
    box = (vehicle.length, vehicle.width)
    recorded, own = (ego_centre(one[ego.POSE], vehicle.centre_offset) for one in (logged, first))
    taken = [(EGO, "the ego", own, box)]
    for one in actors:
        name = who(setup, one.track.track_id)
        taken.append((one.track.track_id, name, one.states[0, :3], tuple(one.track.size[:2])))
    found: dict[str, StartingActor] = {}
    ids = [one.track.track_id for one in actors]
    members = traffic_of(setup.log, setup.traffic, ids, times, vehicle)
    # Those that are labelled come first: they stay where others would begin in them.
    members.sort(key=lambda one: not one.track.trajectory.covers(start_us))
    for track, motion, together in members:
        actor = _begin(setup, motion, track, target)
        pose, key = actor.states[0, :3], track.track_id
        hit = [
            (other, name, area)
            for other, name, there, size in taken
            if (area := float(boxes.bev_overlap_area(there, size, pose, track.size))) > TOUCHING
            and not (other in together and _as_logged(setup, other, there, start_us))
        ]
        fault = None
        if boxes.bev_overlap_area(recorded, box, pose, track.size) > TOUCHING:
            fault = "lies on the ego in the log"
        elif hit and not track.trajectory.covers(start_us):
            fault = f"would begin in {hit[0][1]}: it is not labelled yet"
        elif hit:
            problem = f"track {key} and {hit[0][1]} overlap by {hit[0][2]:.2f} m2 at the start"
            mend = "choose another start, motion or setting, or traffic none"
            raise InputError(setup.log.name, f"rollout {setup.name}", problem, mend)
        if fault is not None:
            text = f"{setup.log.name}: track {key} is left out of the traffic: it {fault}"
            warnings.warn(text, RuntimeWarning, stacklevel=2)
            continue
        taken.append((key, f"track {key}", pose, tuple(track.size[:2])))
        if isinstance(motion, YieldingTraffic):
            there, in_space = motion.in_space()[None], motion.in_space
        else:
            there, in_space = motion.in_space(times), None
        found[key] = replace(actor, road=None, world_from_actor=there, in_space=in_space)
    return [found[key] for key in setup.log.tracks if key in found]


def _as_logged(setup: RolloutSetup, track_id: str, pose: Array, time_us: int) -> bool:
    """Whether a road user is where the log has it."""
    track = setup.log.tracks.get(track_id)
    if track is None or not track.trajectory.covers(time_us):
        return False
    away = track.trajectory.at(time_us)[:2, 3] - pose[:2]
    return float(np.linalg.norm(away)) <= ELSEWHERE


def _lifted(actor: StartingActor, surface: RoadSurface, steps: int) -> StartingActor:
    states = actor.states[: steps + 1]
    if actor.road is None:  # it is lifted already
        return replace(actor, states=states)
    poses = surface.actor_poses(states[:, :3], actor.track.size)
    return replace(actor, states=states, world_from_actor=poses)


def _start(setup: RolloutSetup) -> int:
    log = setup.log.world_from_rig
    first, last = int(log.timestamps_us[0]), int(log.timestamps_us[-1])
    if setup.start_timestamp_us is not None:
        if not first <= setup.start_timestamp_us <= last:
            raise InputError(
                setup.log.name,
                "start_timestamp_us",
                f"{setup.start_timestamp_us} lies outside the log",
                f"choose a time within [{first}, {last}]",
            )
        return setup.start_timestamp_us
    after = start_after(setup.motion)
    if after is not None:
        asked = first + round(after * 1e6)
        if asked > last:
            there = (last - first) * 1e-6
            problem = f"starts {after:g} s after the first ego pose, but the log has {there:g} s"
            raise InputError(
                setup.log.name, f"scenario {setup.name}", problem, "use the log of the scenario"
            )
        return asked
    latest = last - round(setup.steps * setup.dt * 1e6)
    for timestamp in log.timestamps_us[log.timestamps_us <= latest]:
        state = initial_state(log.timestamps_us, log.poses, int(timestamp), setup.vehicle)
        if state[ego.VX] >= _MIN_START_SPEED:
            return int(timestamp)
    return first


def _situation(
    setup: RolloutSetup, route: ReferenceRoute, state: Array, start_us: int, seed: int
) -> StartSituation:
    """Where everything is, as the target sees it."""
    s = float(route.project(state, route.at_time(start_us))[0]) + setup.vehicle.centre_offset
    track = setup.track
    return StartSituation(
        route=route,
        ego_s=s,
        ego_speed=float(state[ego.VX]),
        ego_length=setup.vehicle.length,
        actor_size=track.size,
        neighbour_lateral=neighbour_lateral(setup.log, setup.hdmap, route, s),
        track_id=track.track_id,
        trajectory=track.trajectory,
        start_timestamp_us=start_us,
        seed=seed,
    )


ON_ROAD = 0.5
"""Share of the actor's box that must lie on the drivable area."""
_ROUTE_ON_MAP = 0.5
_TOLERANCE = 0.3
"""Metres beside the drivable area that still count as on the map, as in the metric DAC."""
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
            where it stands, so it is not refused by a map; people may stand beside the road.
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
            if overlap > TOUCHING:
                fault = f"{name} and {other} overlap by {overlap:.2f} m2 at the start"
                break
        anywhere = motion.follows_log or track.category in PEOPLE
        share = 1.0 if anywhere else float(on_road_shares(road, pose, track.size))
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
