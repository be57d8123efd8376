"""Back from an imported log to the frame in which a made-up street was written."""

from __future__ import annotations

import numpy as np

from recast.geometry import se3
from recast.logs import DrivingLog


def street_from_world(log: DrivingLog, dataset_from_street: np.ndarray) -> np.ndarray:
    """(4, 4), by way of the dataset's own coordinates and the log's offset from them."""
    dataset_from_world = se3.from_rotation_translation(np.eye(3), log.world_offset)
    street: np.ndarray = se3.inverse(dataset_from_street) @ dataset_from_world
    return street
