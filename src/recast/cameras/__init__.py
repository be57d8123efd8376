"""Cameras: pinholes and other lenses, mounts on the rig, virtual views."""

from recast.cameras.lenses import Lens, LensCamera, RadialLens, RationalLens
from recast.cameras.mounts import CameraMount, Look, View, nuplan_rig
from recast.cameras.pinhole import PinholeCamera, box_outline, box_rectangle

__all__ = [
    "CameraMount",
    "Lens",
    "LensCamera",
    "Look",
    "PinholeCamera",
    "RadialLens",
    "RationalLens",
    "View",
    "box_outline",
    "box_rectangle",
    "nuplan_rig",
]
