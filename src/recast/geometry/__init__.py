"""Poses, cameras, boxes, polylines, and the light behind colours. numpy only, nothing of ours."""

from recast.geometry import boxes, se2, se3
from recast.geometry.camera import PinholeCamera
from recast.geometry.polyline import Polyline

__all__ = ["PinholeCamera", "Polyline", "boxes", "se2", "se3"]
