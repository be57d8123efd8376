"""NAVSIM agents as planners, in this process and without the `navsim` package."""

from recast_bridges.navsim.planner import NavsimAgent, NavsimPlanner, resample
from recast_bridges.navsim.types import (
    NAVSIM_CAMERAS,
    NUPLAN_RIG,
    AgentInput,
    Camera,
    Cameras,
    EgoStatus,
    Lidar,
    SensorConfig,
    Trajectory,
    TrajectorySampling,
)

__all__ = [
    "NAVSIM_CAMERAS",
    "NUPLAN_RIG",
    "AgentInput",
    "Camera",
    "Cameras",
    "EgoStatus",
    "Lidar",
    "NavsimAgent",
    "NavsimPlanner",
    "SensorConfig",
    "Trajectory",
    "TrajectorySampling",
    "resample",
]
