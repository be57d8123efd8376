"""Pictures as published networks take them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor


def whole_picture(processor: Any, image: NDArray[np.float64]) -> Tensor:
    """(1, 3, h, w) what a network is given: all of an image (H, W, 3) in [0, 1], at its size.

    Published processors cut the middle out of the resized picture, and DINOv2's even out of a
    square one: a vehicle that fills the picture would lose its ends. Here nothing is cut, as in
    the FD by DINOv2 (dgm-eval), which resizes directly.

    Args:
        processor: image processor of transformers.
    """
    picture = Image.fromarray(np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8))
    given = processor(
        images=picture, do_resize=True, size=_input_size(processor), do_center_crop=False,
        return_tensors="pt",
    )  # fmt: skip
    pixels: Tensor = given["pixel_values"].float()
    return pixels


def _input_size(processor: Any) -> dict[str, int]:
    """Height and width of what a processor of transformers gives."""
    size = processor.crop_size if processor.do_center_crop else processor.size
    edge = size.get("shortest_edge")
    return {side: edge or size[side] for side in ("height", "width")}
