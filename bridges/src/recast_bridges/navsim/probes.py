"""NAVSIM agents whose motion is known in advance, to prove frame conventions.

Each can be named, as `navsim:recast_bridges.navsim.probes:left_arc_agent`.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from recast.planning.simple import PROBE_CURVATURES, arc
from recast_bridges.navsim.types import AgentInput, SensorConfig, Trajectory, TrajectorySampling


class ProbeAgent:
    """Drives an arc at its present speed.

    Args:
        name: one of `PROBE_CURVATURES`.
        interval: seconds between the poses it answers with.
    """

    def __init__(self, name: str, interval: float = 0.5) -> None:
        self.name = name
        self._curvature = PROBE_CURVATURES[name]
        self._sampling = TrajectorySampling(time_horizon=4.0, interval_length=interval)

    def initialize(self) -> None:
        """Nothing to load."""

    def get_sensor_config(self) -> SensorConfig:
        """It needs no sensors."""
        return SensorConfig.build_no_sensors()

    def compute_trajectory(self, agent_input: AgentInput) -> Trajectory:
        """The arc for the coming 4 s."""
        speed = float(agent_input.ego_statuses[-1].ego_velocity[0])
        assert self._sampling.num_poses is not None and self._sampling.interval_length is not None
        times = self._sampling.interval_length * np.arange(1, self._sampling.num_poses + 1)
        return Trajectory(arc(self._curvature, speed * times).astype(np.float32), self._sampling)


straight_agent = partial(ProbeAgent, "straight")
left_arc_agent = partial(ProbeAgent, "left-arc")
right_arc_agent = partial(ProbeAgent, "right-arc")
