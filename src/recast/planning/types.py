"""The seam between the simulator and the planner under test: what goes in, what comes out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array, Image
from recast.cameras import CameraMount
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

    It may also have `camera_names`, the only cameras to be rendered for it; or
    `choose_cameras(mounts)`, which returns their names once it is known which there are, or a
    mapping from its own names to them; see `recast.planning.camera_choice`. With `wanted_views`, a
    tuple of `recast.cameras.View`, it gets virtual cameras where no camera of the log will do; see
    `recast.planning.virtual_mounts`. For records, `device` says where it computes, and the mapping
    `record_fields` what else there is to say. `finish_rollout()` is called by `run_rollout` after
    each rollout, also after one that failed.
    If `replays_log` is true, its plans are the logged poses, and a rollout executes the logged
    states themselves: the tracker's error would make them another drive.
    If `shared` is true, one program behind it serves all processes, so no two of them may use it at
    once.

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
