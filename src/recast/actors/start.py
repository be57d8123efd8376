"""Where an asset stands before anything is refined: turned, scaled by the length, on the floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from recast.actors.generate import Asset
from recast.actors.hull import Surface, bounds, outer_surface
from recast.errors import InputError
from recast.geometry import se3
from recast.splats import Gaussians

Array = NDArray[np.float64]

_LARGEST = 1e5  # extent at which everything must still be in range: no box asks for a larger one


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


def stood_up(asset: Asset) -> tuple[Gaussians, Surface]:
    """An asset with its axes turned upright, in its own units, and its outer surface.

    Raises:
        InputError: it is hardly opaque, has no volume, or has values that are not finite or out of
            range, if only at the size of a box.
    """
    where, mend = f"asset of {asset.generator}", "take another seed, or export it again"
    fault = asset.gaussians.fault()
    if fault is not None:
        raise InputError(where, *fault, mend)
    turn = se3.from_rotation_translation(asset.axes.rotation(), np.zeros(3))
    gaussians = asset.gaussians.detach().transformed(torch.from_numpy(turn))
    try:
        surface = outer_surface(gaussians)
    except ValueError as error:
        raise InputError(where, "shape", str(error), mend) from None
    extent = float(np.ptp(surface.points, axis=0).max())
    fault = gaussians.transformed(torch.eye(4), _LARGEST / extent).fault()
    if fault is not None:
        problem = f"at the size of a box, {fault[1]} (it extends over {extent:.3g} units)"
        raise InputError(where, fault[0], problem, mend)
    return gaussians, surface


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
