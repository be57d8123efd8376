"""The planner of a run: what stands for it in a fingerprint, and the cameras rendered for it."""

from __future__ import annotations

from recast.logs import DrivingLog
from recast.pipeline.config import RunConfig
from recast.pipeline.fingerprint import folder_hash
from recast.planning import CameraMount, Planner, named_cameras, planner_cameras, planner_folder
from recast.planning.gtrs import nuplan_rig
from recast.simulation import camera_mounts


def planner_source(name: str) -> str:
    """What stands for a planner in a fingerprint: the content of its folder, or its name."""
    folder = planner_folder(name)
    return name if folder is None else folder_hash(folder)


def run_mounts(log: DrivingLog, planner: Planner, config: RunConfig) -> dict[str, CameraMount]:
    """The cameras that a run renders: the log's, and those of nuPlan's rig that the planner names.

    All at the scale of the scene's images; nuPlan's are virtual and have 1920x1080 at scale 1.

    Raises:
        InputError: the configuration names a camera that the log lacks, or the planner wants one
            that is not there or cannot use its size.
    """
    mounts = camera_mounts(log, config.scene.cameras or None, config.scene.scale)
    named = named_cameras(planner) or ()
    virtual = nuplan_rig(config.scene.scale)
    mounts |= {name: virtual[name] for name in named if name in virtual and name not in mounts}
    planner_cameras(planner, mounts)
    return mounts
