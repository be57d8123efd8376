"""From the tiny drive's log to the street it was made from."""

from __future__ import annotations

import numpy as np

from recast.geometry import se3
from recast.logs import DrivingLog
from support import tiny_drive as tiny


def seconds(log: DrivingLog, timestamps_us: np.ndarray) -> np.ndarray:
    """Time since the first trigger, which the scanner stamps."""
    return (np.asarray(timestamps_us) - log.lidars["velodyne"].timestamps_us[0]) / 1e6


def street_from_world() -> np.ndarray:
    """(4, 4); the log's origin is the first recorded ego place."""
    turned = se3.from_rotation_translation(se3.rotation_z(tiny.STREET_HEADING), np.zeros(3))
    start = turned @ tiny.street_from_rig(tiny.OXTS_DELAY)
    return se3.inverse(se3.from_rotation_translation(np.eye(3), -start[:3, 3]) @ turned)
