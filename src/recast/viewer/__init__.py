"""A page and a replay file that show scenes, actors and rollouts in three dimensions."""

from recast.viewer.drives import (
    CameraImages,
    FilmFile,
    FilmFrames,
    LogFilm,
    MountedCamera,
    Runner,
    ViewedDrive,
    ViewerEvent,
    ViewInputs,
    recording,
    rollout_drive,
    scene_drive,
    still,
)
from recast.viewer.page import (
    MOST_GAUSSIANS,
    REPLAY_MB,
    Page,
    ReplaySize,
    require_viser,
    write_replay,
)

__all__ = [
    "MOST_GAUSSIANS",
    "REPLAY_MB",
    "CameraImages",
    "FilmFile",
    "FilmFrames",
    "LogFilm",
    "MountedCamera",
    "Page",
    "ReplaySize",
    "Runner",
    "ViewInputs",
    "ViewedDrive",
    "ViewerEvent",
    "recording",
    "require_viser",
    "rollout_drive",
    "scene_drive",
    "still",
    "write_replay",
]
