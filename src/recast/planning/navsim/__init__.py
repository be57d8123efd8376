"""NAVSIM agents as planners, in this process and without the `navsim` package."""

from recast.planning.navsim.cameras import NAVSIM_CAMERAS, NUPLAN_RIG
from recast.planning.navsim.planner import NavsimAgent, NavsimPlanner
from recast.planning.navsim.resample import resample
from recast.planning.navsim.types import (
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
