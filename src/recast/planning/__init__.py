"""The planner seam, the reference route, and simple planners."""

from recast.planning.cameras import (
    ShownView,
    camera_choice,
    looked_at,
    named_cameras,
    planner_cameras,
    seen_lines,
    seen_record,
    shown_views,
    virtual_mounts,
)
from recast.planning.idm_follower import IdmFollowerConfig, IdmLaneFollower
from recast.planning.lens import Lens
from recast.planning.registry import (
    ALPASIM_PREFIX,
    DEVICE_PATTERN,
    GTRS_MINI,
    NAVSIM_PREFIX,
    PLANNERS,
    make_planner,
    planner_device,
    planner_folder,
    planner_source_files,
    shipped_folder,
)
from recast.planning.route import DrivingCommand, ReferenceRoute, route_lanes
from recast.planning.simple import ConstantVelocity, LogReplay
from recast.planning.types import (
    WAYPOINTS,
    ActorState,
    CameraMount,
    Candidates,
    Plan,
    Planner,
    PlannerInput,
    PlanningContext,
    ego_status,
)
from recast.planning.views import View, nuplan_rig

__all__ = [
    "ALPASIM_PREFIX",
    "DEVICE_PATTERN",
    "GTRS_MINI",
    "NAVSIM_PREFIX",
    "PLANNERS",
    "WAYPOINTS",
    "ActorState",
    "CameraMount",
    "Candidates",
    "ConstantVelocity",
    "DrivingCommand",
    "IdmFollowerConfig",
    "IdmLaneFollower",
    "Lens",
    "LogReplay",
    "Plan",
    "Planner",
    "PlannerInput",
    "PlanningContext",
    "ReferenceRoute",
    "ShownView",
    "View",
    "camera_choice",
    "ego_status",
    "looked_at",
    "make_planner",
    "named_cameras",
    "nuplan_rig",
    "planner_cameras",
    "planner_device",
    "planner_folder",
    "planner_source_files",
    "route_lanes",
    "seen_lines",
    "seen_record",
    "shipped_folder",
    "shown_views",
    "virtual_mounts",
]
