"""A restorer that can be named."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from recast.arrays import Image


class Negative:
    """Turns every image into its negative."""

    name = "negative"

    def restore(self, images: Mapping[str, Image]) -> dict[str, Image]:
        return {name: np.uint8(255) - image for name, image in images.items()}
