"""The interface between simulator and planner under test: what goes in, what comes out."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array, Image
from recast.cameras import CameraMount, View
from recast.core.foreign import Around, BasePart, whole
from recast.dynamics import PACIFICA, EgoState, VehicleParameters
from recast.dynamics import state as ego
from recast.logs.hdmap import HdMap
from recast.logs.types import Trajectory
from recast.planning.route import DrivingCommand, ReferenceRoute

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


@dataclass(frozen=True)
class ActorState:
    """One other road user now.

    Attributes:
        pose: (3,) x, y, heading of the box centre, world.
        velocity: (2,) m/s, world; need not point along the heading.
        category: category as in `Track.category`.
        size: (3,) length, width, height in metres.
    """

    track_id: str
    category: str
    pose: Array
    velocity: Array
    size: Array


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
    """

    name: str
    needs_images: bool = False
    camera_names: Sequence[str] | None = None
    wanted_views: Sequence[View] = ()
    device: str | None = None
    replays_log: bool = False
    shared: bool = False

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
