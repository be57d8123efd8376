"""What a camera of the synthetic world yields."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.rendering.embree import Float32Array
from recast.synthetic.rendering.ray_scene import SKY


@dataclass(frozen=True)
class CameraFrame:
    """One image and what is exactly known about it.

    Attributes:
        rgb: (H, W, 3) uint8 sRGB. In front of an empty street: the colour of the vehicles alone,
            not mixed with anything behind them.
        depth: (H, W) float32 metres along the camera's z axis through the pixel centre, inf where
            the sky is.
        instance: (H, W) uint16 at the pixel centre: 0 the street, i + 1 the i-th of the scene's
            sorted model names, `SKY` where nothing is.
        alpha: (H, W) float32 share of the pixel that is not sky.
    """

    rgb: NDArray[np.uint8]
    depth: Float32Array
    instance: NDArray[np.uint16]
    alpha: Float32Array

    def within(self, width: int, height: int, left: int, top: int) -> CameraFrame:
        """The frame as part of a larger one (height, width), sky with no colour around it."""
        rgb = np.zeros((height, width, 3), np.uint8)
        depth = np.full((height, width), np.inf, np.float32)
        instance = np.full((height, width), SKY, np.uint16)
        alpha = np.zeros((height, width), np.float32)
        rows, columns = self.depth.shape
        part = slice(top, top + rows), slice(left, left + columns)
        rgb[part], depth[part] = self.rgb, self.depth
        instance[part], alpha[part] = self.instance, self.alpha
        return CameraFrame(rgb, depth, instance, alpha)
