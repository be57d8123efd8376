"""The planner seam, the reference route, and simple planners."""

from recast.planning.cameras import (
    ShownView,
    camera_choice,
    looked_at,
    planner_cameras,
    seen_lines,
    seen_record,
    shown_views,
    virtual_mounts,
)
from recast.planning.idm_follower import IdmFollowerConfig, IdmLaneFollower
from recast.planning.registry import (
    DEVICE_PATTERN,
    GTRS_MINI,
    PLANNERS,
    make_planner,
    planner_device,
    planner_folder,
    planner_source,
    shipped_folder,
)
from recast.planning.route import DrivingCommand, ReferenceRoute, route_lanes
from recast.planning.simple import ConstantVelocity, LogReplay
from recast.planning.types import (
    WAYPOINTS,
    ActorState,
    BasePlanner,
    Candidates,
    Plan,
    Planner,
    PlannerAround,
    PlannerInput,
    PlanningContext,
    ego_status,
)

__all__ = [
    "DEVICE_PATTERN",
    "GTRS_MINI",
    "PLANNERS",
    "WAYPOINTS",
    "ActorState",
    "BasePlanner",
    "Candidates",
    "ConstantVelocity",
    "DrivingCommand",
    "IdmFollowerConfig",
    "IdmLaneFollower",
    "LogReplay",
    "Plan",
    "Planner",
    "PlannerAround",
    "PlannerInput",
    "PlanningContext",
    "ReferenceRoute",
    "ShownView",
    "camera_choice",
    "ego_status",
    "looked_at",
    "make_planner",
    "planner_cameras",
    "planner_device",
    "planner_folder",
    "planner_source",
    "route_lanes",
    "seen_lines",
    "seen_record",
    "shipped_folder",
    "shown_views",
    "virtual_mounts",
]
