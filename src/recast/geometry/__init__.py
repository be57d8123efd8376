"""Poses, cameras, boxes and polylines. numpy only; imports nothing of ours."""

from recast.geometry import boxes, se2, se3
from recast.geometry.camera import PinholeCamera
from recast.geometry.polyline import Polyline

__all__ = ["PinholeCamera", "Polyline", "boxes", "se2", "se3"]
