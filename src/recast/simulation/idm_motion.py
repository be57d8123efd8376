"""The motion of an actor that follows a path and keeps its distance: it reacts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from recast.arrays import Array
from recast.dynamics import IdmParameters, idm_acceleration
from recast.geometry import boxes, se2
from recast.planning import ActorState, ReferenceRoute
from recast.simulation.actor_motion import MotionInput, StartSituation

DRIVER = IdmParameters(max_acceleration=1.5, max_deceleration=2.5, emergency_deceleration=8.0)
"""Accelerations of the driver; gap and headway are the motion's."""
_CORRIDOR_MARGIN = 0.3
"""Metres on each side of the actor's width within which a road user is on its path."""


@dataclass(frozen=True)
class Idm:
    """Follows a path at a desired speed and keeps its distance from whoever is ahead on it.

    The path is the actor's own logged one, at whose place at the start it begins with its logged
    speed. If `gap` is given, it is the ego's route: the actor begins `gap` metres ahead of the ego
    at the desired speed. The speed follows the intelligent driver model behind the nearest road
    user whose box is within the actor's width and 0.3 m on each side: ego, controlled and logged
    actors. Nothing is predicted: a vehicle that crosses the path is seen once it is on it.

    Attributes:
        speed: desired, as a share of the reference speed v_r.
        headway: seconds behind the one ahead.
        min_gap: metres to it at a standstill, bumper to bumper.
        gap: metres ahead of the ego at the start; None for the actor's own path.
        lateral: metres to the left of the ego's route; needs `gap`.

    Raises:
        ValueError: `lateral` is given without `gap`, or a parameter is out of range.
    """

    setting: str
    speed: float = 1.0
    headway: float = 1.5
    min_gap: float = 2.0
    gap: float | None = None
    lateral: float = 0.0
    name: str = "idm"
    description: str = ""

    def __post_init__(self) -> None:
        if self.gap is None and self.lateral != 0.0:
            raise ValueError("lateral: is an offset from the ego's route; give gap, too")
        for name, least in (("speed", 0.0), ("min_gap", 0.0)):
            if not getattr(self, name) > least:
                raise ValueError(f"{name}: is {getattr(self, name)}; give more than 0")
        if not self.headway >= 0.0:
            raise ValueError(f"headway: is {self.headway}; give 0 or more")

    @property
    def follows_log(self) -> bool:
        """Whether the path is the actor's own."""
        return self.gap is None

    def start(self, situation: StartSituation) -> Array:
        """The state (4,) at the start, on the path.

        Raises:
            InputError: the path is the actor's own, and it is not labelled at the start.
        """
        if self.gap is not None:
            pose = situation.route.pose(situation.ahead(self.gap), self.lateral)
            return _state(pose, self.speed * situation.reference_speed)
        track, now = situation.labelled(), situation.start_timestamp_us
        s, _ = situation.own_path.project(se2.from_se3(track.at(now)))
        around = np.clip([now - 100_000, now + 100_000], *track.timestamps_us[[0, -1]])
        moved = float(np.linalg.norm(np.diff(track.at(around)[:, :2, 3], axis=0)))
        speed = moved / max((around[1] - around[0]) * 1e-6, 1e-6)
        return _state(situation.own_path.pose(s), speed)

    def step(self, state: MotionInput, dt: float) -> Array:
        """One forward Euler step (4,) of the model, as in `recast.dynamics.idm_step`."""
        path, speed = self._path(state.situation), float(state.state[3])
        s = float(path.project(state.state)[0])
        leads = self._leads(state, path, s)
        target = self.speed * state.situation.reference_speed
        parameters = replace(DRIVER, headway=self.headway, min_gap=self.min_gap)
        acceleration = min(
            (
                float(idm_acceleration(speed, target, gap, lead_speed, parameters))
                for gap, lead_speed in (*leads, (np.inf, 0.0))
            )
        )
        faster = max(speed + acceleration * dt, 0.0)
        if speed == 0.0:  # projecting back and forth would let a standing car creep
            return np.append(state.state[:3], faster)
        return _state(path.pose(s + speed * dt, self.lateral), faster)

    def _path(self, situation: StartSituation) -> ReferenceRoute:
        return situation.own_path if self.gap is None else situation.route

    def _leads(
        self, state: MotionInput, path: ReferenceRoute, s: float
    ) -> Iterable[tuple[float, float]]:
        """Gap in metres, bumper to bumper, and speed along the path of all who are ahead on it."""
        length, width = state.situation.actor_size[:2]
        half = width / 2 + _CORRIDOR_MARGIN
        for user in state.road_users:
            centre = float(path.project(user.pose)[0])
            if centre <= s:
                continue
            along, lateral = path.project(_outline(user))
            offset = lateral - self.lateral
            if offset.min() > half or offset.max() < -half:
                continue
            heading = float(path.heading(centre))
            lead_speed = user.velocity @ [np.cos(heading), np.sin(heading)]
            yield float(along.min()) - s - length / 2, float(lead_speed)


def _outline(user: ActorState) -> Array:
    """Corners and middles of the sides (8, 2): a long vehicle across the path has both ends beside
    it."""
    corners = boxes.bev_corners(user.pose, *user.size[:2])
    return np.concatenate([corners, (corners + np.roll(corners, -1, axis=0)) / 2])


def _state(pose: Array, speed: float) -> Array:
    return np.append(np.append(pose[:2], se2.wrap_angle(pose[2])), speed)
