"""`recast bench scene-level`: how real and how complete the images of arms look (paper, Q2)."""

from recast.studies.scene_level.command import run_scene_level
from recast.studies.scene_level.request import LEVEL_MOTIONS, LevelSettings, NetworkFiles

__all__ = ["LEVEL_MOTIONS", "LevelSettings", "NetworkFiles", "run_scene_level"]
