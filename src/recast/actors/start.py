"""Where an asset stands before anything is refined: turned, scaled by the length, on the floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.actors.hull import Surface, bounds
from recast.geometry import se3

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Start:
    """asset_placed = matrix (scale x), with the asset's axes turned upright already.

    Attributes:
        yaw: about the vertical, radians.
        scale: metres per unit of the asset.
        matrix: (4, 4) rigid part, applied after the scale.
    """

    yaw: float
    scale: float
    matrix: Array

    def apply(self, surface: Surface) -> Surface:
        """The surface, placed."""
        points = se3.apply(self.matrix, surface.points * self.scale)
        return Surface(points, surface.normals @ self.matrix[:3, :3].T, surface.index)


def stand_on_box(points: Array, yaw: float, size: Array) -> Start:
    """Turn by `yaw`, scale the length to the box's, centre on the box, stand on its floor.

    Args:
        points: (N, 3) surface of the asset, z up.
        yaw: radians.
        size: (3,) length, width, height of the box, metres.
    """
    rotation = se3.rotation_z(yaw)
    low, high = bounds(points @ rotation.T)
    scale = float(size[0] / (high[0] - low[0]))
    centre = (low + high) / 2 * scale
    bottom = float((points @ rotation.T)[:, 2].min()) * scale
    shift = np.array([-centre[0], -centre[1], -size[2] / 2 - bottom])
    return Start(yaw, scale, se3.from_rotation_translation(rotation, shift))
