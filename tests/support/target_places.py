"""What the tests of the target builder share."""

from __future__ import annotations

from recast.recar import VehicleSet
from recast.recar.target_maker import ModelSource, TargetSettings

SETTINGS = TargetSettings(max_voxels=4096)
Places = tuple[VehicleSet, ModelSource]
