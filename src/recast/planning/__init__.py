"""The planner seam, the reference route, and simple planners."""

from recast.planning.cameras import camera_choice, named_cameras, planner_cameras
from recast.planning.constant_velocity import ConstantVelocity
from recast.planning.device import DEVICE_PATTERN, planner_device
from recast.planning.idm_follower import IdmFollowerConfig, IdmLaneFollower
from recast.planning.log_replay import LogReplay
from recast.planning.registry import (
    NAVSIM_PREFIX,
    PLANNERS,
    make_planner,
    planner_folder,
    planner_source_files,
)
from recast.planning.route import DrivingCommand, ReferenceRoute, route_lanes
from recast.planning.shipped import GTRS_MINI, gtrs_mini
from recast.planning.status import ego_status
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
from recast.planning.views import View
from recast.planning.virtual import (
    ShownView,
    seen_lines,
    seen_record,
    shown_views,
    virtual_mounts,
)

__all__ = [
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
    "gtrs_mini",
    "make_planner",
    "named_cameras",
    "planner_cameras",
    "planner_device",
    "planner_folder",
    "planner_source_files",
    "route_lanes",
    "seen_lines",
    "seen_record",
    "shown_views",
    "virtual_mounts",
]
