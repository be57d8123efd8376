"""The seam between the simulator and what controlled actors do, and what they start from."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.foreign import BasePart, lacks, whole
from recast.geometry import Polyline, boxes, se2
from recast.logs.hdmap import HdMap
from recast.logs.types import DrivingLog, Track, Trajectory
from recast.planning import ActorState, ReferenceRoute, route_lanes

EGO = "ego"
"""Track id and category of the ego where it is a road user among others."""
DEFAULT_LANE_OFFSET = 3.5
"""Metres to the neighbouring lane where the map knows none."""
_STRAIGHT = 1000.0
"""Metres of the made-up path of a vehicle that the log saw standing."""
_LANE_OFFSETS = (2.5, 4.5)
"""Metres beside the route at which a vehicle drives in the next lane."""
_SAME_DIRECTION = np.deg2rad(15)
_MOVING = 2.0
_MIN_POSES = 10


@dataclass(frozen=True)
class StartSituation:
    """Where everything is when a rollout starts, as seen by one controlled actor.

    Attributes:
        route: the ego's reference route.
        ego_s: route coordinate of the ego's box centre, metres.
        ego_speed: speed of the ego, m/s.
        ego_length: length of the ego's box, metres.
        actor_size: (3,) length, width, height of the actor's box, metres.
        neighbour_lateral: offset in metres, left positive, of the neighbouring lane of the same
            direction; None where there is none.
        track_id: id of the actor's track.
        trajectory: `world_from_object` of the actor as the log has it; None if there is none.
        start_timestamp_us: log time of the start.
        seed: seed of the rollout, for motions that draw random numbers.
    """

    route: ReferenceRoute
    ego_s: float
    ego_speed: float
    ego_length: float
    actor_size: Array
    neighbour_lateral: float | None = None
    track_id: str = ""
    trajectory: Trajectory | None = None
    start_timestamp_us: int = 0
    seed: int = 0

    @property
    def reference_speed(self) -> float:
        """v_r: the ego's speed within [4, 12] m/s, which scales the moving motions."""
        return float(np.clip(self.ego_speed, 4.0, 12.0))

    @property
    def beside(self) -> float:
        """Lateral offset of a car in the next lane: the neighbour's, or 3.5 m to the left."""
        return DEFAULT_LANE_OFFSET if self.neighbour_lateral is None else self.neighbour_lateral

    def ahead(self, gap: float) -> float:
        """Route coordinate of the actor's centre, `gap` metres from the ego's front bumper."""
        return self.ego_s + gap + (self.ego_length + float(self.actor_size[0])) / 2

    def labelled(self) -> Trajectory:
        """The actor's logged trajectory, which covers the start.

        Raises:
            InputError: the log does not have the actor at the start.
        """
        track = self.trajectory
        if track is None or not track.covers(self.start_timestamp_us):
            problem = "has no logged trajectory"
            if track is not None:
                after = [(t - self.start_timestamp_us) * 1e-6 for t in track.timestamps_us[[0, -1]]]
                problem = (
                    "is not labelled at the start: its labels go from "
                    f"{after[0]:.1f} to {after[1]:.1f} s after it"
                )
            mend = "choose another start, track or motion"
            raise InputError("rollout", f"track {self.track_id}", problem, mend)
        return track

    @cached_property
    def own_path(self) -> ReferenceRoute:
        """The path that the log saw the actor drive, for its box centre; straight ahead of the pose
        at the start if it moved less than 4 m.

        Raises:
            InputError: see `labelled`.
        """
        track = self.labelled()
        try:
            return ReferenceRoute.from_trajectory(track)
        except InputError:
            pose = se2.from_se3(track.at(self.start_timestamp_us))
            end = se2.compose(pose, [_STRAIGHT, 0.0, 0.0])
            line = Polyline(np.stack([pose[:2], end[:2]]))
            return ReferenceRoute(line, np.full(2, pose[2]), np.zeros(2))


def neighbour_lateral(
    log: DrivingLog, hdmap: HdMap | None, route: ReferenceRoute, s: float
) -> float | None:
    """Offset in metres, left positive, of the next lane of the same direction.

    By a surveyed map: the neighbour of the lane at route coordinate `s`, the left one first. Else
    by the recorded traffic, which shows where lanes are better than a derived map does: the median
    offset of vehicles that drove beside the route in its direction, on the side where more were
    seen. Else by the derived map. None where nothing tells.
    """
    mapped = None if hdmap is None else _by_map(hdmap, route, s)
    if hdmap is not None and not hdmap.derived and mapped is not None:
        return mapped
    driven = _by_traffic(log, route)
    return mapped if driven is None else driven


def _by_traffic(log: DrivingLog, route: ReferenceRoute) -> float | None:
    offsets = np.concatenate(
        [np.zeros(0), *(_driven_beside(track, route) for track in log.tracks.values())]
    )
    left, right = offsets[offsets > 0], offsets[offsets < 0]
    side = left if len(left) >= len(right) else right
    return float(np.median(side)) if len(side) >= _MIN_POSES else None


def _by_map(hdmap: HdMap, route: ReferenceRoute, s: float) -> float | None:
    for lane in route_lanes(hdmap, route):
        along, _ = route.project(lane.centreline)
        if not along.min() <= s <= along.max():
            continue
        for neighbour in (lane.left_neighbour, lane.right_neighbour):
            if neighbour is None:
                continue
            beside, lateral = route.project(hdmap.lanes[neighbour].centreline)
            if beside.min() <= s <= beside.max():  # a neighbour may begin further on
                return float(lateral[np.argmin(np.abs(beside - s))])
    return None


def _driven_beside(track: Track, route: ReferenceRoute) -> Array:
    """Offsets of a track's poses in the next lane, moving in the route's direction."""
    times = track.trajectory.timestamps_us * 1e-6
    if len(times) < 2:
        return np.zeros(0)
    poses = se2.from_se3(track.trajectory.poses)
    s, lateral = route.project(poses)
    speed = np.gradient(s, times)
    turn = np.abs(se2.wrap_angle(poses[:, 2] - route.heading(s)))
    near, far = _LANE_OFFSETS
    beside = (np.abs(lateral) >= near) & (np.abs(lateral) <= far)
    beside &= (speed >= _MOVING) & (turn <= _SAME_DIRECTION) & (s >= 0) & (s <= route.length)
    return lateral[beside]


@dataclass(frozen=True)
class RoadUsers:
    """Road users at one step, as arrays that all motions share.

    Attributes:
        users: the U road users.
    """

    users: tuple[ActorState, ...]

    @cached_property
    def ids(self) -> NDArray[np.str_]:
        """Track ids (U,)."""
        return np.array([user.track_id for user in self.users])

    @cached_property
    def velocities(self) -> Array:
        """Velocities (U, 2), world, m/s."""
        return np.array([user.velocity for user in self.users])

    @cached_property
    def points(self) -> Array:
        """Centres, corners and middles of the sides (U, 9, 2): a long vehicle across a path has
        both ends beside it."""
        poses = np.array([user.pose for user in self.users])
        sizes = np.array([user.size[:2] for user in self.users])
        corners = boxes.bev_corners(poses, sizes[:, 0], sizes[:, 1])
        middles = (corners + np.roll(corners, -1, axis=1)) / 2
        return np.concatenate([poses[:, None, :2], corners, middles], axis=1)


@dataclass(frozen=True)
class MotionInput:
    """What a motion sees at one step.

    Attributes:
        situation: situation at the start.
        step: step of `state`, 0 at the start.
        steps: how many steps the rollout was asked for.
        state: (4,) x, y, heading of the actor's box centre, speed; world, SI units.
        ego: the ego now, its box and velocity; its `track_id` is "ego".
        others: the other road users now: controlled actors in their order, then logged ones.
        everyone: the ego, the actor itself and the others, shared by all motions of the step; None
            if they are not.
        travelled: metres that the actor has moved since the start; None if that is not known.
    """

    situation: StartSituation
    step: int
    steps: int
    state: Array
    ego: ActorState
    others: tuple[ActorState, ...] = ()
    everyone: RoadUsers | None = None
    travelled: float | None = None

    @property
    def shared(self) -> RoadUsers:
        """All road users, the actor itself perhaps among them."""
        return self.everyone or RoadUsers(self.road_users)

    @property
    def road_users(self) -> tuple[ActorState, ...]:
        """The ego and the others."""
        return (self.ego, *self.others)


@dataclass(frozen=True)
class Quantity:
    """A number of a motion in a scenario file; annotates the member that it sets.

    Attributes:
        unit: name of the unit, as people read it.
        low, high: the range, both included.
        positive: `low` is 0 and itself not allowed.
        optional: may be left out; the motion has a default.
    """

    unit: str
    low: float
    high: float
    positive: bool = False
    optional: bool = False

    def fault(self, value: float) -> str | None:
        """What is wrong with a number, or None."""
        if not math.isfinite(value):
            return f"is {value}"
        if value < 0.0 <= self.low:
            return "is negative"
        if not self.low <= value <= self.high or (self.positive and value == 0.0):
            return f"is {value:g}"
        return None

    @property
    def range(self) -> str:
        """The range and the unit, such as "-50 to 500 m"."""
        low = "more than 0, at most" if self.positive else f"{self.low:.5g} to"
        return f"{low} {self.high:.5g} {self.unit}"


class Rows:
    """Rows of numbers of a motion in a scenario file; annotates the member that they set.

    Args:
        columns: the quantity of each number of a row.
        least: fewest rows.
    """

    def __init__(self, *columns: Quantity, least: int) -> None:
        self.columns, self.least = columns, least


class NamedMotion(Protocol):
    """What every motion has."""

    @property
    def name(self) -> str:
        """For tables and file names, such as "idm"."""

    @property
    def setting(self) -> str:
        """Which parameters, such as "a"."""


class ActorMotion(NamedMotion, Protocol):
    """Moves a controlled actor step by step. Implement this for a motion that reacts.

    States are (4,): x, y, heading of the box centre in the world, speed >= 0; SI units. These
    members are enough; `BaseMotion` has all others, with their defaults.
    """

    def start(self, situation: StartSituation) -> Array:
        """The state (4,) at the start."""

    def step(self, state: MotionInput, dt: float) -> Array:
        """The state (4,) `dt` seconds after `state`."""


class ScriptMotion(NamedMotion, Protocol):
    """A motion that is known at the start, since it does not react; see also `BaseScript`."""

    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """States (steps + 1, 4): x, y, heading of the box centre, speed >= 0; world, SI units."""


class BaseMotion(BasePart):
    """An `ActorMotion` with all members that are asked for: derive yours from it.

    Attributes:
        name, setting: see `NamedMotion`.
        description: one sentence for people, or "".
        follows_log: whether the actor stays on its own logged path: the rollout is then not cut
            where that path leaves the ego's recorded road.
    """

    name: str
    setting: str
    description: str = ""
    follows_log: bool = False

    @abstractmethod
    def start(self, situation: StartSituation) -> Array:
        """The state (4,) at the start."""

    @abstractmethod
    def step(self, state: MotionInput, dt: float) -> Array:
        """The state (4,) `dt` seconds after `state`."""


class BaseScript(BaseMotion):
    """A `ScriptMotion` with all members: `start` and `step` give what `script` says."""

    def start(self, situation: StartSituation) -> Array:
        """The first state (4,) of the script."""
        return self.script(situation, 1, 0.1)[0]

    def step(self, state: MotionInput, dt: float) -> Array:
        """The state (4,) after `state.step`, whatever the others do."""
        return self.script(state.situation, state.steps, dt)[state.step + 1]

    @abstractmethod
    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """States (steps + 1, 4), see `ScriptMotion`."""


AnyMotion = ActorMotion | ScriptMotion
"""What a controlled actor may be given."""


def whole_motion(motion: AnyMotion, where: str = "motion") -> BaseMotion:
    """The motion with all members, see `recast.core.foreign.whole`; a `BaseScript` if it is known
    at the start.

    Args:
        where: whose motion it is, for errors.

    Raises:
        InputError: it is no motion, or a member is of the wrong kind.
    """
    if not lacks(motion, BaseScript):
        return whole(motion, BaseScript)
    if not lacks(motion, BaseMotion):
        return whole(motion, BaseMotion)
    raise InputError(
        where,
        type(motion).__name__,
        "is not a motion: a motion has name, setting, and start and step, or script",
        "give a motion, such as motion('cut-in'); see docs/scenarios.md#your-own-in-python",
    )
