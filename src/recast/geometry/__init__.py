"""Poses, cameras, boxes, polylines, and the light behind colours. numpy only, nothing of ours."""

from recast.geometry import boxes, se2, se3
from recast.geometry.camera import PinholeCamera
from recast.geometry.lens import LensCamera, RadialLens, RationalLens
from recast.geometry.polyline import Polyline

__all__ = [
    "LensCamera",
    "PinholeCamera",
    "Polyline",
    "RadialLens",
    "RationalLens",
    "boxes",
    "se2",
    "se3",
]
