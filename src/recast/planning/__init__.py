"""The planner seam, the reference route, and simple planners."""

from recast.planning.constant_velocity import ConstantVelocity
from recast.planning.idm_follower import IdmFollowerConfig, IdmLaneFollower
from recast.planning.log_replay import LogReplay
from recast.planning.registry import PLANNERS, make_planner
from recast.planning.route import DrivingCommand, ReferenceRoute, route_lanes
from recast.planning.types import (
    WAYPOINTS,
    ActorState,
    CameraMount,
    Candidates,
    Plan,
    Planner,
    PlannerInput,
    PlanningContext,
)

__all__ = [
    "PLANNERS",
    "WAYPOINTS",
    "ActorState",
    "CameraMount",
    "Candidates",
    "ConstantVelocity",
    "DrivingCommand",
    "IdmFollowerConfig",
    "IdmLaneFollower",
    "LogReplay",
    "Plan",
    "Planner",
    "PlannerInput",
    "PlanningContext",
    "ReferenceRoute",
    "make_planner",
    "route_lanes",
]
