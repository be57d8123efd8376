"""Observations of the environment: arrays in the ego frame, of fixed shapes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from recast.dynamics import state as ego
from recast.geometry import se2
from recast.planning import ActorState, CameraMount, PlannerInput, ReferenceRoute
from recast.planning.status import COMMANDS

Array = NDArray[np.float64]

ROUTE_POINTS = 20
ROUTE_SPACING = 2.5
"""Metres between the points of the route ahead."""
ACTOR_COLUMNS = ("x", "y", "heading", "vx", "vy", "length", "width", "height")
"""Box centre and velocity in the ego frame; the velocity is that over ground, not relative to the
ego's."""
_SECONDS = 2.0


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
        ego on, its end repeated beyond it; `command`, an index into `recast.planning.status.
        COMMANDS`; `actors` (A, 8), see `ACTOR_COLUMNS`, in the order of `PlannerInput.actors`, and
        `actors_mask` (A,), 1 where there is one; `images` by camera name.
    """
    pose = seen.ego.pose
    past = np.asarray(seen.ego_history, np.float64)[-history:].copy()
    past[:, ego.POSE] = se2.relative(pose, past[:, ego.POSE])
    past[-1, ego.POSE] = 0.0  # exactly
    missing = history - len(past)
    s = float(route.project(pose)[0])
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
        made["images"] = dict(seen.images)
    return made


def _actor(pose: Array, actor: ActorState) -> Array:
    turned = se2.relative([0.0, 0.0, pose[2]], [*actor.velocity, 0.0])[:2]
    return np.concatenate([se2.relative(pose, actor.pose), turned, actor.size])


def _numbers(*shape: int) -> spaces.Box:
    return spaces.Box(-np.inf, np.inf, shape, np.float32)
