"""A page and a replay file that show scenes, actors and rollouts in three dimensions."""

from recast.viewer.drives import (
    FilmFile,
    FilmFrames,
    LogFilm,
    recording,
    rollout_drive,
    scene_drive,
    still,
)
from recast.viewer.inputs import (
    CameraImages,
    MountedCamera,
    Runner,
    ViewedDrive,
    ViewerEvent,
    ViewInputs,
)
from recast.viewer.page import MOST_GAUSSIANS, Page, require_viser
from recast.viewer.replay import REPLAY_MB, ReplaySize, write_replay

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
