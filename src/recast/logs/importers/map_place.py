"""Does a map lie where its drive was?"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from recast.logs.hdmap import Lane
from recast.logs.types import Array

NEAR = 200.0
"""Metres that the ego may be beside the lanes' bounding box."""


def metres_beside(lanes: Mapping[str, Lane], ego: Array) -> float:
    """How far the ego's places (T, 2) are beside the bounding box of all lanes, at the most."""
    points = np.concatenate([lane.polygon for lane in lanes.values()])
    beside = np.maximum(points.min(axis=0) - ego, ego - points.max(axis=0))
    return float(np.linalg.norm(np.maximum(beside, 0.0), axis=1).max())
