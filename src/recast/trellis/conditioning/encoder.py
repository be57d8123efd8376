"""The seam between crops and generation: what every image encoder offers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from torch import Tensor

from recast.trellis.conditioning.read import Picture

# Mean and standard deviation of ImageNet's pixels, with which DINOv2 was trained.
_MEAN = (0.485, 0.456, 0.406)
_STD = (0.229, 0.224, 0.225)


@runtime_checkable
class ImageEncoder(Protocol):
    """Turns square crops on black into the context of the generation's cross-attention."""

    @property
    def image_size(self) -> int:
        """Side of the crops in pixels, to give to `crop_to_object`."""
        ...

    @property
    def channels(self) -> int:
        """Channels of a token."""
        ...

    def encode(self, images: Tensor) -> Tensor:
        """Crops (B, 3, S, S) float32 in [0, 1] to tokens (B, L, channels), layer-normalised."""
        ...


def images_from_crops(crops: Sequence[Picture]) -> Tensor:
    """Stack crops of `crop_to_object` for an encoder.

    Args:
        crops: B crops (S, S, 3) uint8 of the same size.

    Returns:
        (B, 3, S, S) float32 in [0, 1].
    """
    stacked = torch.from_numpy(np.stack(crops))
    return stacked.permute(0, 3, 1, 2).float().div(255)


def normalise(images: Tensor) -> Tensor:
    """Images (B, 3, H, W) in [0, 1] to zero mean and unit deviation over ImageNet."""
    mean, std = (images.new_tensor(values).view(3, 1, 1) for values in (_MEAN, _STD))
    return (images - mean) / std
