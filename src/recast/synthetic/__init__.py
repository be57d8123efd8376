"""Synthetic drives with ground truth: streets, vehicles, traffic, sensors, and the oracle."""

from recast.synthetic.populate import (
    TARGET,
    WORLD_VERSION,
    check_drive,
    drive_metadata,
    drive_of,
    is_synthetic,
    make_world,
    world_metadata,
    world_of,
)
from recast.synthetic.streets import SCENES
from recast.synthetic.world import CAMERAS, World, make_rig, read_truth
from recast.synthetic.write import Oracle, check_request, synthesize_log

__all__ = [
    "CAMERAS",
    "SCENES",
    "TARGET",
    "WORLD_VERSION",
    "Oracle",
    "World",
    "check_drive",
    "check_request",
    "drive_metadata",
    "drive_of",
    "is_synthetic",
    "make_rig",
    "make_world",
    "read_truth",
    "synthesize_log",
    "world_metadata",
    "world_of",
]
