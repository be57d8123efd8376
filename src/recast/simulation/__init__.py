"""Scenarios, actor motions, the ego controller, the rollout loop and what it leaves behind."""

from recast.simulation.rollout import (
    EGO_COLUMNS,
    PATH_COLUMNS,
    Rollout,
    RolloutFailure,
    ego_centre,
)
from recast.simulation.rollout_files import load_rollout, save_rollout

__all__ = [
    "EGO_COLUMNS",
    "PATH_COLUMNS",
    "Rollout",
    "RolloutFailure",
    "ego_centre",
    "load_rollout",
    "save_rollout",
]
