"""Distorted images from a renderer that only knows pinhole cameras."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.geometry import PinholeCamera

Image = NDArray[np.uint8]


class Lens:
    """Bends pinhole images to those of a camera with distortion.

    Render with `source`, then call `bend`. The map is computed once.

    Args:
        camera: of the images to be made.

    Attributes:
        camera: as given.
        source: rectified camera at the same place, with the same focal lengths, just large enough
            to see all that `camera` sees.
    """

    def __init__(self, camera: PinholeCamera) -> None:
        self.camera = camera
        rays = camera.rays(camera.pixel_grid())[..., :2] * [camera.fx, camera.fy]
        # Half a pixel beyond the outermost centres is what the outermost pixels cover.
        low = np.floor(rays.min((0, 1)) - 0.5 + 1e-6)
        width, height = np.ceil(rays.max((0, 1)) + 0.5 - 1e-6 - low).astype(int).tolist()
        self.source = PinholeCamera(width, height, camera.fx, camera.fy, *(-low).tolist())
        # OpenCV counts from the centre of the first pixel.
        x, y = np.moveaxis(rays - low - 0.5, -1, 0).astype(np.float32)
        self._x, self._y = np.ascontiguousarray(x), np.ascontiguousarray(y)

    def bend(self, image: Image) -> Image:
        """A `source` image (h, w, 3) uint8 as `camera` sees it (height, width, 3).

        Raises:
            ValueError: the image does not have the size of `source`.
        """
        if image.shape[:2] != (self.source.height, self.source.width):
            expected = (self.source.height, self.source.width)
            raise ValueError(f"Lens.bend: expected {expected} pixels, got {image.shape[:2]}")
        bent = cv2.remap(image, self._x, self._y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(bent, np.uint8)
