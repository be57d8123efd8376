"""Poses, boxes, polylines, and the light behind colours. numpy only, nothing of ours."""

from recast.geometry import boxes, se2, se3
from recast.geometry.se2 import Polyline

__all__ = [
    "Polyline",
    "boxes",
    "se2",
    "se3",
]
