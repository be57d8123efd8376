"""What a planner sees and answers, and the reference route that it is told."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from recast.arrays import Array, Image
from recast.cameras import CameraMount, View
from recast.core.errors import InputError
from recast.core.foreign import Around, BasePart, whole
from recast.dynamics import PACIFICA, EgoState, VehicleParameters
from recast.dynamics import state as ego
from recast.geometry import Polyline, se2
from recast.geometry.se2 import REACH
from recast.logs.hdmap import HdMap, Lane
from recast.logs.types import Trajectory

_KNOT_SPACING = 2.0
"""Metres between spline knots: wide enough that centimetres of pose noise leave headings smooth."""
_SAMPLE_SPACING = 0.5
_CUSP_LENGTH, _CUSP_TURN = 4.0, 2.0
"""Metres, and radians over them, that no car turns in: its radius is 4.5 m or more."""
_COMMAND_LOOKAHEAD = 20.0
_COMMAND_OFFSET = 2.0
_LANE_DISTANCE = 2.5
_LANE_ANGLE = np.pi / 4


class DrivingCommand(StrEnum):
    """Where the route leads next, as planners trained on OpenScene expect it."""

    LEFT = "left"
    STRAIGHT = "straight"
    RIGHT = "right"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class ReferenceRoute:
    """A smooth directed path with Frenet coordinates: s along, lateral to the left, metres.

    Attributes:
        line: the path, sampled every half metre.
        headings: (N,) tangent at its points, unwrapped radians.
        speeds: (N,) logged speed at its points, m/s.
        seconds: (N,) log time at its points, or None for a route that is no drive.
    """

    line: Polyline
    headings: Array
    speeds: Array
    seconds: Array | None = None

    @classmethod
    def from_trajectory(cls, trajectory: Trajectory) -> ReferenceRoute:
        """The route of a logged drive: a cubic spline through positions 2 m apart.

        Raises:
            InputError: the log moves less than 4 m, so that there is no route.
        """
        xy = trajectory.poses[:, :2, 3]
        knots = _knots(xy)
        if len(knots) < 3:
            raise InputError(
                "log",
                "world_from_rig",
                f"the ego moves less than {2 * _KNOT_SPACING:g} m, so there is no route to follow",
                "use a part of the log in which the ego drives",
            )
        chord = np.concatenate(
            [[0.0], np.cumsum(np.linalg.norm(np.diff(xy[knots], axis=0), axis=1))]
        )
        spline = CubicSpline(chord, xy[knots])
        u = np.linspace(0.0, chord[-1], int(np.ceil(chord[-1] / _SAMPLE_SPACING)) + 1)
        line = Polyline(spline(u))
        tangent = spline(u, 1)
        seconds = trajectory.timestamps_us[knots] * 1e-6
        # Time over arc length is monotone where speed over arc length would need smoothing.
        elapsed = np.interp(u, chord, seconds)
        return cls(
            line=line,
            headings=np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0])),
            speeds=np.gradient(line.arc_lengths, elapsed),
            seconds=elapsed,
        )

    @property
    def length(self) -> float:
        """Metres from end to end."""
        return self.line.length

    def heading(self, s: ArrayLike) -> Array:
        """Tangent heading (...), continuous in s; constant beyond the ends."""
        angle: Array = np.interp(np.asarray(s, np.float64), self.line.arc_lengths, self.headings)
        return se2.wrap_angle(angle)

    def logged_speed(self, s: ArrayLike) -> Array:
        """Speed (...) in m/s at which the log drove over arc lengths (...)."""
        return np.interp(np.asarray(s, np.float64), self.line.arc_lengths, self.speeds)

    def pose(self, s: ArrayLike, lateral: ArrayLike = 0.0) -> Array:
        """Poses (..., 3) at Frenet coordinates, heading along the route.

        Continued straight beyond the ends: callers that must stay on the recorded road compare s
        with `length`.
        """
        s, lateral = np.broadcast_arrays(np.asarray(s, np.float64), lateral)
        heading = self.heading(s)
        normal = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        xy = self.line.position(s) + lateral[..., None] * normal
        return np.concatenate([xy, heading[..., None]], axis=-1)

    def at_time(self, timestamp_us: ArrayLike) -> Array | None:
        """Arc lengths (...) that the log had reached at times; None for a route without times."""
        if self.seconds is None:
            return None
        times = np.asarray(timestamp_us, np.float64) * 1e-6
        return np.interp(times, self.seconds, self.line.arc_lengths)

    def follow(self, points: ArrayLike, near: float) -> Array:
        """Coordinates s (T,) of points (T, >=2) in the order of time: each near the one before.

        Args:
            near: the coordinate before the first one.
        """
        found, before = [], None
        for point in np.asarray(points, np.float64)[:, :2]:
            moved = 0.0 if before is None else float(np.linalg.norm(point - before))
            near, before = float(self.project(point, near, REACH + moved)[0]), point
            found.append(near)
        return np.array(found)

    @cached_property
    def cusps(self) -> Array:
        """Coordinates at which the drive turns back into itself: it began or ended to reverse."""
        s, span = self.line.arc_lengths, round(_CUSP_LENGTH / _SAMPLE_SPACING)
        turned = np.abs(self.headings[span:] - self.headings[:-span]) > _CUSP_TURN
        begins = np.flatnonzero(turned & ~np.append(False, turned[:-1]))
        return np.asarray(s[np.minimum(begins + span, len(s) - 1)])

    def project(
        self, points: ArrayLike, near: ArrayLike | None = None, reach: float = REACH
    ) -> tuple[Array, Array]:
        """Frenet coordinates s (...), lateral (...) of points (..., >=2).

        Unlike `Polyline.to_frenet`, s is negative before the start and exceeds `length` past the
        end, measured along the end tangents.

        Args:
            near, reach: coordinates (...) near which they are, see `Polyline.to_frenet`.
        """
        xy = np.asarray(points, np.float64)[..., :2]
        s, lateral = self.line.to_frenet(xy, near, reach)
        for end, beyond in ((0.0, s <= 0.0), (self.length, s >= self.length)):
            offset = xy - self.line.position(end)
            heading = float(self.line.heading(end))
            along = offset[..., 0] * np.cos(heading) + offset[..., 1] * np.sin(heading)
            across = offset[..., 1] * np.cos(heading) - offset[..., 0] * np.sin(heading)
            s = np.where(beyond, end + along, s)
            lateral = np.where(beyond, across, lateral)
        return s, lateral

    def command(self, pose: ArrayLike, near: float | None = None) -> DrivingCommand:
        """The driving command at a pose (>=2,), OpenScene's rule.

        `near` is as for `project`.

        From the route point beside the ego to the one 20 m on, seen in the frame of the first:
        2 m or more to a side is a turn. Less than 20 m from the end of the route, the end counts;
        off its ends the command is unknown.
        """
        s = float(self.project(pose, near)[0])
        if not 0.0 <= s <= self.length:
            return DrivingCommand.UNKNOWN
        here, ahead = self.pose(s), self.pose(min(s + _COMMAND_LOOKAHEAD, self.length))
        offset = float(se2.relative(here, ahead)[1])
        if offset >= _COMMAND_OFFSET:
            return DrivingCommand.LEFT
        if offset <= -_COMMAND_OFFSET:
            return DrivingCommand.RIGHT
        return DrivingCommand.STRAIGHT


def route_lanes(hdmap: HdMap, route: ReferenceRoute) -> tuple[Lane, ...]:
    """Lanes that the route drives on: within 2.5 m and 45 degrees of it, in its order.

    Where parallel lanes both qualify, the one nearer to the route comes first.
    """
    found: list[tuple[float, float, Lane]] = []
    for lane in hdmap.lanes.values():
        centreline = Polyline.from_points(lane.centreline)
        s, lateral = route.project(centreline.points)
        turn = se2.wrap_angle(centreline.heading(centreline.arc_lengths) - route.heading(s))
        near = (np.abs(lateral) <= _LANE_DISTANCE) & (np.abs(turn) <= _LANE_ANGLE)
        near &= (s >= 0.0) & (s <= route.length)
        if np.any(near):
            found.append((float(s[near].min()), float(np.abs(lateral[near]).mean()), lane))
    return tuple(lane for _, _, lane in sorted(found, key=lambda item: item[:2]))


def _knots(xy: Array) -> list[int]:
    """Indices of positions at least a knot spacing apart; the last one is the log's end."""
    points = xy.tolist()  # plain floats: ten times faster one by one than array rows
    knots = [0]
    for i, point in enumerate(points):
        if math.dist(point, points[knots[-1]]) >= _KNOT_SPACING:
            knots.append(i)
    last = len(points) - 1
    if knots[-1] != last and len(knots) > 1:
        # A knot too near to the end gives way to it: the route ends where the log does.
        if math.dist(points[last], points[knots[-1]]) <= _KNOT_SPACING / 2:
            knots.pop()
        knots.append(last)
    return knots


WAYPOINTS = 40
"""Waypoints of a plan, `PlanningContext.dt` apart: 0.1 s .. 4.0 s ahead."""
COMMANDS = (
    DrivingCommand.LEFT,
    DrivingCommand.STRAIGHT,
    DrivingCommand.RIGHT,
    DrivingCommand.UNKNOWN,
)
"""Order of the one-hot driving command."""


@dataclass(frozen=True)
class PlanningContext:
    """What stays the same during a rollout; given to `Planner.reset`.

    Attributes:
        route: route to follow: the logged ego path, for the rear axle.
        log: the recorded ego drive. Only planners that replay it, or that need a usual speed,
            should look at it.
        map: lanes and drivable area, or None.
        vehicle: the ego's outline.
        cameras: cameras by name, whose images `PlannerInput.images` will hold; empty without
            images.
        dt: seconds between waypoints.
        plan_every: steps of `dt` between two calls of `plan`.
        seed: seed of the rollout, for random numbers of the planner's own. The global ones of
            `random`, `numpy` and `torch` are seeded with it already.
    """

    route: ReferenceRoute
    log: Trajectory
    map: HdMap | None = None
    vehicle: VehicleParameters = PACIFICA
    cameras: Mapping[str, CameraMount] = field(default_factory=dict)
    dt: float = 0.1
    plan_every: int = 5
    seed: int = 0


ACTOR_COLUMNS = ("x", "y", "heading", "vx", "vy", "length", "width", "height")
"""Box centre and velocity in the ego frame; the velocity is that over ground, not relative to the
ego's."""


@dataclass(frozen=True)
class ActorState:
    """One other road user now.

    Attributes:
        pose: (3,) x, y, heading of the box centre, world.
        velocity: (2,) m/s, world; need not point along the heading.
        category: category as in `Track.category`.
        size: (3,) length, width, height in metres.
        future: (F, 3) poses of the box centre from now on, `dt` apart, world: where it truly will
            be. None wherever that is not told; see `BasePlanner.foresees`.
    """

    track_id: str
    category: str
    pose: Array
    velocity: Array
    size: Array
    future: Array | None = None

    def seen_from(self, pose: Array) -> Array:
        """(8,) see `ACTOR_COLUMNS`, for an ego at a pose (3,)."""
        turned = se2.relative([0.0, 0.0, pose[2]], [*self.velocity, 0.0])[:2]
        return np.concatenate([se2.relative(pose, self.pose), turned, self.size])


@dataclass(frozen=True)
class PlannerInput:
    """What the planner sees at one cycle.

    Attributes:
        step: simulation step, 0 at the start of the rollout.
        timestamp_us: log time of the step.
        ego: (11,) current ego state, by name (`ego.vx`) or by the columns of
            `recast.dynamics.state`; a plain array that is given becomes one.
        ego_history: (H, 11) past states `dt` apart, oldest first, the current one last; up to 2 s.
            States before the rollout's start are the log's.
        actors: the other road users: the target, further controlled actors, then logged ones.
        images: rendered camera images (H, W, 3) uint8 RGB by name; empty unless the planner has
            `needs_images`.
        route_s: coordinate of the ego on the route, metres. A route may come back over itself: the
            place nearest to the ego may be another one. None if it is not known.
    """

    step: int
    timestamp_us: int
    ego: EgoState
    ego_history: Array
    actors: tuple[ActorState, ...]
    command: DrivingCommand
    images: Mapping[str, Image] = field(default_factory=dict)
    route_s: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "ego", EgoState(self.ego))


@dataclass(frozen=True)
class Candidates:
    """The best of the trajectories that a planner chose from, best first.

    Attributes:
        waypoints: (K, 40, 3) waypoints, each as in `Plan.waypoints`.
        scores: (K,) falling; what they mean is the planner's business.
    """

    waypoints: Array
    scores: Array


@dataclass(frozen=True)
class Plan:
    """A planner's answer.

    Attributes:
        waypoints: (40, 3) x, y, heading of the rear axle in the current ego frame, at 0.1 s .. 4 s.
        info: anything worth keeping beside it, for debugging.
        candidates: what else it considered, or None where it does not choose from a set.
    """

    waypoints: Array
    info: Mapping[str, float | str] = field(default_factory=dict)
    candidates: Candidates | None = None

    def validate(self) -> None:
        """Raise ValueError naming what is wrong with the waypoints."""
        try:
            waypoints = np.asarray(self.waypoints, np.float64)
        except (TypeError, ValueError):
            raise ValueError("Plan.waypoints: is not an array of numbers") from None
        if waypoints.shape != (WAYPOINTS, 3):
            raise ValueError(f"Plan.waypoints: expected ({WAYPOINTS}, 3), got {waypoints.shape}")
        bad = ~np.isfinite(waypoints).all(axis=1)
        if bad.any():
            raise ValueError(f"Plan.waypoints: NaN or infinity at waypoint {int(np.argmax(bad))}")


@runtime_checkable
class Planner(Protocol):
    """Drives the ego. One instance may drive many rollouts, one after the other.

    What it is given is read-only: copy an array before you change it. What it returns is copied.
    These members are enough; `BasePlanner` has all others, with their defaults.

    Attributes:
        needs_images: whether `PlannerInput.images` must be filled; rendering costs far more than
            anything else, so planners that read states say False.
    """

    name: str
    needs_images: bool

    def reset(self, context: PlanningContext) -> None:
        """Forget the last rollout and prepare for the next."""

    def plan(self, observation: PlannerInput) -> Plan:
        """Plan the next 4 s from what is seen now."""


class BasePlanner(BasePart):
    """A `Planner` with all members that are asked for: derive yours from it to have the defaults.

    A planner of another class may have any of them, too; see `recast.core.foreign.whole`.

    Attributes:
        camera_names: the only cameras to be rendered for it; None for those that the setup names.
        wanted_views: views for which it gets virtual cameras where no camera of the log will do;
            see `recast.planning.virtual_mounts`.
        device: where it computes, for records.
        replays_log: whether its plans are the logged poses. A rollout then executes the logged
            states themselves: the tracker's error would make them another drive.
        shared: whether one program behind it serves all processes, so that no two of them may use
            it at once.
        foresees: whether it is told `ActorState.future`, as an expert that labels what others shall
            learn; no planner to be tested.
    """

    name: str
    needs_images: bool = False
    camera_names: Sequence[str] | None = None
    wanted_views: Sequence[View] = ()
    device: str | None = None
    replays_log: bool = False
    shared: bool = False
    foresees: bool = False

    @property
    def record_fields(self) -> Mapping[str, str | float]:
        """What else records shall say of it."""
        return {}

    def reset(self, context: PlanningContext) -> None:
        """Forget the last rollout and prepare for the next."""

    @abstractmethod
    def plan(self, observation: PlannerInput) -> Plan:
        """Plan the next 4 s from what is seen now."""

    def choose_cameras(
        self, mounts: Mapping[str, CameraMount]
    ) -> Sequence[str] | Mapping[str, str] | None:
        """Names of the cameras to render, or a mapping from its own names to them.

        Args:
            mounts: cameras that there are; see `recast.planning.camera_choice`.

        Returns:
            None for the cameras that the setup names.
        """
        return self.camera_names

    def finish_rollout(self) -> None:
        """Called by `run_rollout` after each rollout, also after one that failed."""


class PlannerAround(Around, BasePlanner):
    """A planner that does what another one does, except for what a derived class says.

    Args:
        planner: the other one, of any class.
    """

    def __init__(self, planner: Planner) -> None:
        super().__init__(whole(planner, BasePlanner))

    def plan(self, observation: PlannerInput) -> Plan:
        """See `Planner`."""
        return self.part.plan(observation)


def ego_status(command: DrivingCommand, state: ArrayLike) -> NDArray[np.float32]:
    """(8,) float32: left, straight, right, unknown, vx, vy, ax, ay.

    Ego frame, rear axle, m/s and m/s^2. As the simulator moves without slip, vy is 0 and ay the
    centripetal acceleration, speed times yaw rate, which the logs that the released models were
    trained on contain and the kinematic state does not.

    Args:
        command: see `ReferenceRoute.command`.
        state: (11,) ego state, columns of `recast.dynamics.state`.
    """
    state = np.asarray(state, np.float64)
    speed = state[ego.VX]
    motion = (speed, 0.0, state[ego.AX], speed * state[ego.ANGULAR_VELOCITY])
    return np.array([*(command == known for known in COMMANDS), *motion], np.float32)
