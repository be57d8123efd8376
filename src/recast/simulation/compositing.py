"""Images put together: a vehicle and a street that were drawn apart, by depth, with shadow.

Colours are display values in [0, 1] unless the text says that they are linear light.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.arrays import Float32Array, Image
from recast.geometry.colour import linear_to_srgb, srgb_to_linear

_BLUR = 1.0  # pixels, standard deviation: ray noise is that of single pixels
_DARK = np.float32(2e-3)  # linear light below which a ratio of two images is that of their rounding
_NEARER = 0.3, 0.02  # metres, and share of the depth, by which a street must be nearer to hide


def as_image(display: NDArray[np.floating]) -> Image:
    """Display values (H, W, 3) as uint8."""
    return (np.clip(display, 0, 1) * 255).round().astype(np.uint8)


def light_left(beside: Image, without: Image) -> Float32Array:
    """Share (H, W, 3) of the linear light of a street that a vehicle leaves, or adds.

    Both images are blurred by a pixel, which hides the noise of their rays. The share is exactly 1
    where they are the same.

    Args:
        beside: (H, W, 3) uint8 the street with what the vehicle shades and mirrors, the vehicle
            itself not seen.
        without: (H, W, 3) uint8 the same view without the vehicle.
    """
    both = (srgb_to_linear(image.astype(np.float32) / 255) for image in (beside, without))
    with_it, without_it = (cv2.GaussianBlur(one.astype(np.float32), (0, 0), _BLUR) for one in both)
    return (with_it + _DARK) / (without_it + _DARK)


def shaded(street: Float32Array, left: Float32Array) -> Float32Array:
    """A street (H, W, 3) of whose linear light the share `left` (H, W, 3) is left."""
    dark = linear_to_srgb(srgb_to_linear(street) * left)
    return np.where(left == 1, street, dark).astype(np.float32)


def vehicle_in_street(
    street: Float32Array,
    front: Float32Array,
    front_alpha: Float32Array,
    vehicle: Image,
    alpha: Float32Array,
) -> Float32Array:
    """A traced vehicle in a street of Gaussians, (H, W, 3).

    Where the vehicle covers a part of a pixel, its light and the street's are added.

    Args:
        street: (H, W, 3) all of the street.
        front: (H, W, 3) the part of the street that is nearer than the vehicle, premultiplied.
        front_alpha: (H, W) opacity of that part.
        vehicle: (H, W, 3) uint8 the vehicle alone, not mixed with anything.
        alpha: (H, W) share of the pixel that it covers.
    """
    shown = front + (1 - front_alpha[..., None]) * (vehicle.astype(np.float32) / 255)
    light = (1 - alpha[..., None]) * srgb_to_linear(street)
    light += alpha[..., None] * srgb_to_linear(np.clip(shown, 0, 1))
    return np.where(alpha[..., None] > 0, linear_to_srgb(light), street).astype(np.float32)


def gaussians_in_truth(
    truth: Image,
    truth_depth: Float32Array,
    layer: Float32Array,
    depth: Float32Array,
    alpha: Float32Array,
) -> Image:
    """Gaussians in front of a traced image, (H, W, 3) uint8; hidden where the street is nearer.

    The street hides them only where it is nearer by more than 0.3 m and 2 % of the depth: a shadow
    lies on the road.

    Args:
        truth: (H, W, 3) uint8 the true image.
        truth_depth: (H, W) depth of the truth at the pixel centres, metres; infinite for the sky.
        layer: (H, W, 3) colour of the Gaussians, premultiplied.
        depth: (H, W) sum of T alpha z of the Gaussians, metres.
        alpha: (H, W) opacity of the Gaussians.
    """
    metres, share = _NEARER
    own = depth / np.maximum(alpha, np.float32(1e-6))
    shown = (alpha > 0) & (own - metres - share * own <= truth_depth)
    mixed = layer + (1 - alpha[..., None]) * (truth.astype(np.float32) / 255)
    return np.where(shown[..., None], as_image(mixed), truth)
