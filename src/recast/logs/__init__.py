"""Driving logs: the data, the store, importers, and what can be derived from a drive."""

from recast.logs.derive_map import derive_map, ego_path, even_ground, map_of
from recast.logs.hdmap import GroundHeight, HdMap, Lane
from recast.logs.load import LogInfo, TrackInfo, TrackVisibility, load_log, log_info
from recast.logs.motion import TrackPoints, all_track_points, track_points
from recast.logs.plausibility import OddLogWarning, Plausibility, plausibility
from recast.logs.store import read_log, write_log
from recast.logs.types import (
    CameraStream,
    DrivingLog,
    LidarStream,
    LidarSweep,
    Track,
    Trajectory,
)

__all__ = [
    "CameraStream",
    "DrivingLog",
    "GroundHeight",
    "HdMap",
    "Lane",
    "LidarStream",
    "LidarSweep",
    "LogInfo",
    "OddLogWarning",
    "Plausibility",
    "Track",
    "TrackInfo",
    "TrackPoints",
    "TrackVisibility",
    "Trajectory",
    "all_track_points",
    "derive_map",
    "ego_path",
    "even_ground",
    "load_log",
    "log_info",
    "map_of",
    "plausibility",
    "read_log",
    "track_points",
    "write_log",
]
