"""What the agent of the environment does and sees: actions and observations, with their spaces."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from recast.arrays import Array
from recast.cameras import CameraMount
from recast.core.errors import InputError
from recast.dynamics import BicycleModel, VehicleParameters
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.planning import (
    WAYPOINTS,
    ActorState,
    Plan,
    PlannerInput,
    PlanningContext,
    ReferenceRoute,
)
from recast.planning.types import COMMANDS
from recast.simulation import BaseController

ActionKind = Literal["waypoints", "controls"]
KINDS = ("waypoints", "controls")

_LOW = np.array([-4.05, -0.5], np.float32)
_HIGH = np.array([2.4, 0.5], np.float32)
_MODEL = BicycleModel()
ROUTE_POINTS = 20
ROUTE_SPACING = 2.5
"""Metres between the points of the route ahead."""
ACTOR_COLUMNS = ("x", "y", "heading", "vx", "vy", "length", "width", "height")
"""Box centre and velocity in the ego frame; the velocity is that over ground, not relative to the
ego's."""
_SECONDS = 2.0


def action_space(kind: ActionKind) -> spaces.Space[NDArray[np.float32]]:
    """Waypoints (40, 3) as in `Plan`, or acceleration in m/s^2 and steering rate in rad/s (2,)."""
    if kind == "waypoints":
        box = spaces.Box(-np.inf, np.inf, (WAYPOINTS, 3), np.float32)
    else:
        box = spaces.Box(_LOW, _HIGH, (2,), np.float32)
    return cast("spaces.Space[NDArray[np.float32]]", box)


def checked_action(action: object, kind: ActionKind) -> Array:
    """An action as float64, controls clipped to their range.

    Raises:
        InputError: it is no array of finite numbers of the right shape.
    """
    shape = (WAYPOINTS, 3) if kind == "waypoints" else (2,)
    mend = f"give {kind} {shape}, as in DrivingEnv.action_space"
    try:
        values = np.asarray(action, np.float64)
    except (TypeError, ValueError):
        raise InputError("DrivingEnv", "action", "is not an array of numbers", mend) from None
    if values.shape != shape:
        raise InputError("DrivingEnv", "action", f"has the shape {values.shape}", mend)
    if not np.isfinite(values).all():
        at = np.argwhere(~np.isfinite(values))[0].tolist()
        raise InputError("DrivingEnv", "action", f"is NaN or infinite at {at}", mend)
    return values if kind == "waypoints" else np.clip(values, _LOW, _HIGH)


class HeldControls(BaseController):
    """An ego controller that holds one acceleration and steering rate, whatever the plan says.

    The kinematic bicycle has the actuator lag of the LQR controller's and never drives backwards.

    Attributes:
        command: (2,) acceleration in m/s^2 and steering rate in rad/s.
    """

    def __init__(self) -> None:
        self.command: Array = np.zeros(2)

    def reset(self, context: PlanningContext) -> None:
        """Neither accelerate nor steer."""
        self.command = np.zeros(2)

    def execute(
        self, state: Array, waypoints: Array, steps: int, vehicle: VehicleParameters, dt: float
    ) -> Array:
        """Ego states (steps + 1, 11), the given one first."""
        states = [np.asarray(state, np.float64)]
        for _ in range(steps):
            new = _MODEL.step(states[-1], self.command, vehicle, dt)
            if new[ego.VX] < 0.0:
                new[[ego.VX, ego.AX, ego.ANGULAR_VELOCITY, ego.ANGULAR_ACCELERATION]] = 0.0
            states.append(new)
        return np.array(states)

    def plan(self, state: Array, vehicle: VehicleParameters, dt: float) -> Plan:
        """Where the command leads within the horizon of a plan: for metrics that look ahead."""
        states = self.execute(state, np.zeros((WAYPOINTS, 3)), WAYPOINTS, vehicle, dt)
        return Plan(se2.relative(states[0, ego.POSE], states[1:, ego.POSE]))


def history_length(dt: float) -> int:
    """States in `history`: 2 s and the present one."""
    return round(_SECONDS / dt) + 1


def observation_space(
    mounts: Mapping[str, CameraMount], history: int, most_actors: int
) -> spaces.Dict:
    """The space of `observation`; without cameras it has no `images`."""
    images: dict[str, spaces.Space[Any]] = {
        name: spaces.Box(0, 255, (mount.camera.height, mount.camera.width, 3), np.uint8)
        for name, mount in mounts.items()
    }
    parts: dict[str, spaces.Space[Any]] = {
        "ego": _numbers(ego.SIZE),
        "history": _numbers(history, ego.SIZE),
        "route": _numbers(ROUTE_POINTS, 2),
        "command": spaces.Discrete(len(COMMANDS)),
        "actors": _numbers(most_actors, len(ACTOR_COLUMNS)),
        "actors_mask": spaces.MultiBinary(most_actors),
    }
    if images:
        parts["images"] = spaces.Dict(images)
    return spaces.Dict(parts)


def observation(
    seen: PlannerInput, route: ReferenceRoute, history: int, most_actors: int
) -> dict[str, Any]:
    """What a planner sees, as arrays in the present ego frame (rear axle).

    Returns:
        `ego` (11,) and `history` (history, 11) with the columns of `recast.dynamics.state`, oldest
        first, the oldest known one repeated before it; `route` (20, 2) points 2.5 m apart from the
        ego on, its end repeated beyond it; `command`, an index into `recast.planning.types.
        COMMANDS`; `actors` (A, 8), see `ACTOR_COLUMNS`, in the order of `PlannerInput.actors`, and
        `actors_mask` (A,), 1 where there is one; `images` by camera name.
    """
    pose = seen.ego.pose
    past = np.asarray(seen.ego_history, np.float64)[-history:].copy()
    past[:, ego.POSE] = se2.relative(pose, past[:, ego.POSE])
    past[-1, ego.POSE] = 0.0  # exactly
    missing = history - len(past)
    s = float(route.project(pose, seen.route_s)[0])
    ahead = np.clip(s + ROUTE_SPACING * np.arange(ROUTE_POINTS), 0.0, route.length)
    actors = np.zeros((most_actors, len(ACTOR_COLUMNS)))
    shown = seen.actors[:most_actors]
    for row, actor in enumerate(shown):
        actors[row] = _actor(pose, actor)
    mask = np.zeros(most_actors, np.int8)
    mask[: len(shown)] = 1
    made: dict[str, Any] = {
        "ego": past[-1].astype(np.float32),
        "history": np.concatenate([np.repeat(past[:1], missing, axis=0), past]).astype(np.float32),
        "route": se2.relative(pose, route.pose(ahead))[:, :2].astype(np.float32),
        "command": np.int64(COMMANDS.index(seen.command)),
        "actors": actors.astype(np.float32),
        "actors_mask": mask,
    }
    if seen.images:
        made["images"] = {name: image.copy() for name, image in seen.images.items()}
    return made


def _actor(pose: Array, actor: ActorState) -> Array:
    turned = se2.relative([0.0, 0.0, pose[2]], [*actor.velocity, 0.0])[:2]
    return np.concatenate([se2.relative(pose, actor.pose), turned, actor.size])


def _numbers(*shape: int) -> spaces.Box:
    return spaces.Box(-np.inf, np.inf, shape, np.float32)
