"""Driving the ego along the waypoints of a plan."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Protocol

from recast.arrays import Array
from recast.core.foreign import BasePart
from recast.dynamics import (
    PRESETS,
    TrackerConfig,
    VehicleParameters,
    follow_perfectly,
    plan_to_poses,
    track,
)
from recast.dynamics import state as ego
from recast.planning import PlanningContext


class EgoController(Protocol):
    """Executes the first waypoints of a plan; what it is given is read-only.

    This method is enough; `BaseController` has all others, with their defaults.
    """

    def execute(
        self, state: Array, waypoints: Array, steps: int, vehicle: VehicleParameters, dt: float
    ) -> Array:
        """Ego states (steps + 1, 11), the given one (11,) first.

        Args:
            waypoints: (40, 3) waypoints in the ego frame of `state`, `dt` apart.
            steps: how many steps to execute.
            vehicle: the ego.
            dt: seconds per step, and between waypoints.
        """


class BaseController(BasePart):
    """An `EgoController` with all members that are asked for: derive yours from it."""

    def reset(self, context: PlanningContext) -> None:
        """Forget the last rollout and prepare for the next."""

    @abstractmethod
    def execute(
        self, state: Array, waypoints: Array, steps: int, vehicle: VehicleParameters, dt: float
    ) -> Array:
        """Ego states (steps + 1, 11), see `EgoController`."""


@dataclass(frozen=True)
class LqrController(BaseController):
    """nuPlan's LQR tracker and kinematic bicycle with actuator lag.

    The paper says that the ego controller executes the first K waypoints, not which controller it
    is. We take the tracker of the benchmark that the published planners were made for.
    """

    config: TrackerConfig = PRESETS["default"]

    def execute(
        self, state: Array, waypoints: Array, steps: int, vehicle: VehicleParameters, dt: float
    ) -> Array:
        """Fit the plan's profiles once and track them; see `recast.dynamics.track`."""
        poses = plan_to_poses(state[ego.POSE], waypoints)
        return track(state, poses, steps, self.config, vehicle, dt)


@dataclass(frozen=True)
class PerfectController(BaseController):
    """Puts the ego onto the waypoints: shows what the plans alone would do."""

    def execute(
        self, state: Array, waypoints: Array, steps: int, vehicle: VehicleParameters, dt: float
    ) -> Array:
        """Jump from waypoint to waypoint; speeds and rates are their differences."""
        poses = plan_to_poses(state[ego.POSE], waypoints)
        return follow_perfectly(state, poses, steps, vehicle, dt)
