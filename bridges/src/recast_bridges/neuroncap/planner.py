"""A program that speaks NeuroNCAP's planner interface as a planner of recast's loop.

recast is the client, as NeuroNCAP's engine is: it asks /alive and /reset before a rollout and
/infer at every plan. Images go out as that interface wants them, see `wire.raw_image`; what comes
back is JSON.
"""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from recast.arrays import Array
from recast.cameras import CameraMount
from recast.core.errors import InputError
from recast.dynamics import state as ego
from recast.geometry import se2, se3
from recast.planning.types import (
    WAYPOINTS,
    BasePlanner,
    Plan,
    PlannerInput,
    PlanningContext,
    ReferenceRoute,
)
from recast_bridges.json_service import JsonService
from recast_bridges.neuroncap.service import ncap_cameras, raw_image

ALIVE_S, RESET_S, INFER_S = 10.0, 60.0, 300.0
"""Seconds within which the program must be there, forget the last rollout, and plan."""
INTERVAL, LEAST = 0.5, 6
"""Seconds between the points of a trajectory, and how many there are at least: 3 s."""
RIGHT, LEFT, STRAIGHT = 0, 1, 2
"""Numbers of the commands."""
LIDAR2EGO = se3.from_rotation_translation(se3.rotation_z(-np.pi / 2), [0.94, 0.0, 1.84])
"""Where nuScenes has its LiDAR (x right, y forward), in which planners trained there compute.

Nothing is measured in this frame here, so any log's cameras may be told against it."""
_ALIVE_ONCE, _PAUSE = 1.0, 0.25
_MOST_ANSWER = 1 << 24
_MOST_POINTS = 100
_FARTHEST = 1e4
"""Metres: a point of a trajectory beyond is a slip."""
_GRAVITY = 9.8
_AHEAD_S, _LEAST_SPEED, _TURN_M = 3.0, 2.0, 2.0
_MOVES = 0.2
"""Speed in m/s below which a path has no heading of its own."""
_LABEL = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]{0,99}")


def neuroncap_planner(word: str) -> NeuroNcapPlanner:
    """The planner of "HOST:PORT" or "LABEL@HOST:PORT"; the label is its name in results.

    Nothing is asked before the first rollout.

    Raises:
        InputError: it is no address, or no label.
    """
    label, at, address = word.rpartition("@")
    name = f"planner neuroncap:{word}"
    if at and not _LABEL.fullmatch(label):
        mend = "use letters, digits, dots, hyphens and underscores"
        raise InputError(name, "label", f"is {label!r}", mend)
    service = JsonService.at(address, name)
    return NeuroNcapPlanner(service, label or f"neuroncap-{service.host}-{service.port}")


class NeuroNcapPlanner(BasePlanner):
    """Drives what another program answers.

    One program has one state, so only one rollout may use it at a time.

    Args:
        service: address at which the program listens.
        name: name for tables and file names.
    """

    needs_images = True
    shared = True

    def __init__(self, service: JsonService, name: str) -> None:
        self.name = name
        self._service = service
        self._cameras: dict[str, str] = {}
        self._context: PlanningContext | None = None

    def choose_cameras(self, mounts: Mapping[str, CameraMount]) -> dict[str, str]:
        """NeuroNCAP's name to the rig's camera that stands for it, see `ncap_cameras`. Raises
        InputError: no camera looks ahead."""
        chosen = ncap_cameras(mounts)
        if "CAM_FRONT" not in chosen:
            mend = "use a log with a camera that looks ahead"
            raise InputError(
                f"planner {self.name}", "CAM_FRONT", "no camera of the log corresponds to it", mend
            )
        return chosen

    def reset(self, context: PlanningContext) -> None:
        """Wait until the program is there, and tell it that a rollout begins. Raises InputError: it
        is not there, or refuses; no camera looks ahead."""
        self._cameras = self.choose_cameras(context.cameras)
        self._context = context
        self._wait()
        self._service.send("POST", "/reset", {}, seconds=RESET_S, most_bytes=_MOST_ANSWER)

    def plan(self, observation: PlannerInput) -> Plan:
        """What the program plans, see `waypoints_of`.

        Raises:
            RuntimeError: `reset` was not called.
            InputError: it answers an error, too late, or no trajectory.
        """
        if self._context is None:
            raise RuntimeError("NeuroNcapPlanner.plan: call reset first")
        body = infer_body(observation, self._context, self._cameras)
        answer = self._service.ask("POST", "/infer", body, seconds=INFER_S, most_bytes=_MOST_ANSWER)
        try:
            points = read_trajectory(answer)
        except ValueError as error:
            raise self._service.fault("/infer", f"gave an invalid answer: {error}") from None
        times = self._context.dt * np.arange(1, WAYPOINTS + 1)
        return Plan(waypoints_of(points, times))

    def _wait(self) -> None:
        ends = time.monotonic() + ALIVE_S
        while True:
            try:
                self._service.send("GET", "/alive", seconds=_ALIVE_ONCE, most_bytes=_MOST_ANSWER)
                return
            except InputError:
                if time.monotonic() >= ends:
                    raise
            time.sleep(_PAUSE)


def infer_body(
    observation: PlannerInput, context: PlanningContext, cameras: Mapping[str, str]
) -> dict[str, Any]:
    """The body of /infer.

    The ego is the rear axle in the world of the log; its height is 0, and it is level.

    Args:
        cameras: NeuroNCAP's name to the rig's.
    """
    now = observation.ego
    x, y, heading = now.pose
    mounts = {name: context.cameras[own] for name, own in cameras.items()}
    speed, turning = now.vx, now.angular_velocity
    position = [float(x), float(y), 0.0]
    turned = [float(np.cos(heading / 2)), 0.0, 0.0, float(np.sin(heading / 2))]
    pulled = [now.ax, speed * turning, _GRAVITY]
    return {
        "images": {name: raw_image(observation.images[own]) for name, own in cameras.items()},
        "ego2world": se2.to_se3(np.asarray(now.pose)).tolist(),
        "canbus": [*position, *turned, *pulled, 0.0, 0.0, turning, speed, now.vy, 0.0],
        "timestamp": observation.timestamp_us,
        "command": command_of(context.route, now, observation.route_s),
        "calibration": {
            "camera2image": {name: _intrinsics(mount) for name, mount in mounts.items()},
            "camera2ego": {name: mount.rig_from_camera.tolist() for name, mount in mounts.items()},
            "lidar2ego": LIDAR2EGO.tolist(),
        },
    }


def _intrinsics(mount: CameraMount) -> list[list[float]]:
    """The matrix with nuScenes' principal point: it counts from the centre of the first pixel."""
    matrix = mount.camera.matrix
    matrix[:2, 2] -= 0.5
    return matrix.tolist()


def command_of(route: ReferenceRoute, state: ArrayLike, route_s: float | None = None) -> int:
    """NeuroNCAP's command: a turn if the route is 2 m or more to a side of where the ego would be
    in 3 s, straight on at its speed, or at 2 m/s if it is slower."""
    now = ego.EgoState(state)
    ahead = max(now.speed, _LEAST_SPEED) * _AHEAD_S
    there = se2.compose(now.pose, [ahead, 0.0, 0.0])
    near = None if route_s is None else route_s + ahead
    on_route = route.pose(route.project(there, near)[0])
    left = float(se2.relative(now.pose, on_route)[1])
    return LEFT if left > _TURN_M else RIGHT if left < -_TURN_M else STRAIGHT


def read_trajectory(answer: object) -> Array:
    """The points (N, 2) of an answer: x forward, y left, metres, 0.5 s apart from 0.5 s on.

    `aux_outputs`, which NeuroNCAP's own evaluation reads, is not looked at.

    Raises:
        ValueError: there is no trajectory, or it is too short, too long or no finite numbers.
    """
    if not isinstance(answer, dict) or "trajectory" not in answer:
        raise ValueError("trajectory is missing")
    listed = answer["trajectory"]
    if not isinstance(listed, list) or not LEAST <= len(listed) <= _MOST_POINTS:
        found = f"has {len(listed)} points" if isinstance(listed, list) else "is not a list"
        raise ValueError(f"trajectory {found}, expected {LEAST} to {_MOST_POINTS} points")
    for number, point in enumerate(listed):
        numbers = isinstance(point, list) and [type(one) in (int, float) for one in point]
        if numbers != [True, True] or not all(abs(one) <= _FARTHEST for one in point):
            raise ValueError(f"trajectory[{number}] is {str(point)[:60]}, not x and y in metres")
    return np.array(listed, np.float64)


def waypoints_of(points: Array, times: ArrayLike) -> Array:
    """Waypoints (M, 3) at `times` of points (N, 2) that are 0.5 s apart.

    x and y are monotone cubics over time (PCHIP) through the present place and the points: they do
    not overshoot where a plan stops. After the last point the velocity stays. The heading is the
    direction of motion; below 0.2 m/s it stays as it was, and a path that goes back is driven
    backwards.
    """
    times, knots = np.asarray(times, np.float64), INTERVAL * np.arange(len(points) + 1)
    path = PchipInterpolator(knots, np.concatenate([np.zeros((1, 2)), points]))
    within = np.minimum(times, knots[-1])
    velocity = path.derivative()(within)
    waypoints = np.empty((len(times), 3))
    waypoints[:, :2] = path(within) + velocity * (times - within)[:, None]
    heading = 0.0
    for number, (forward, left) in enumerate(velocity):
        if np.hypot(forward, left) >= _MOVES:
            turn = float(se2.wrap_angle(np.arctan2(left, forward) - heading))
            if abs(turn) > np.pi / 2:
                turn -= np.copysign(np.pi, turn)
            heading += turn
        waypoints[number, 2] = heading
    waypoints[:, 2] = se2.wrap_angle(waypoints[:, 2])
    return waypoints
