"""From the planner's waypoints to the ego's motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from recast.dynamics import PRESETS, TrackerConfig, follow_perfectly, plan_to_poses, track
from recast.dynamics import state as ego

Array = NDArray[np.float64]


class EgoController(Protocol):
    """Executes the first waypoints of a plan."""

    def execute(self, state: Array, waypoints: Array, steps: int) -> Array:
        """Ego states (steps + 1, 11), the given one (11,) first.

        Args:
            waypoints: (40, 3) in the ego frame of `state`.
            steps: how many 0.1 s steps to execute.
        """


@dataclass(frozen=True)
class LqrController:
    """LQR tracker and kinematic bicycle with actuator lag: what the paper's loop uses."""

    config: TrackerConfig = PRESETS["default"]

    def execute(self, state: Array, waypoints: Array, steps: int) -> Array:
        """Fit the plan's profiles once and track them; see `recast.dynamics.track`."""
        return track(state, plan_to_poses(state[ego.POSE], waypoints), steps, self.config)


@dataclass(frozen=True)
class PerfectController:
    """Puts the ego onto the waypoints: shows what the plans alone would do."""

    config: TrackerConfig = PRESETS["default"]

    def execute(self, state: Array, waypoints: Array, steps: int) -> Array:
        """Jump from waypoint to waypoint; speeds and rates are their differences."""
        poses = plan_to_poses(state[ego.POSE], waypoints)
        return follow_perfectly(state, poses, steps, self.config)
