"""Pictures as published networks take them, a fixed number at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal, TypeVar

import numpy as np
import torch
import torch.nn.functional as functional
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from recast.pretrained.folder import MOST_PIXELS

Picture = NDArray[np.uint8]
"""(H, W, 3), RGB."""
Fit = Literal["whole", "published", "padded"]
"""How a picture is brought to a network's size, see `network_input`."""
Item = TypeVar("Item")

BATCH = 32


def whole_picture(processor: Any, image: NDArray[np.float64]) -> Tensor:
    """(1, 3, h, w) what a network is given: all of an image (H, W, 3) in [0, 1], at its size.

    Published processors cut the middle out of the resized picture, and DINOv2's even out of a
    square one: a vehicle that fills the picture would lose its ends. Here nothing is cut, as in
    the FD by DINOv2 (dgm-eval), which resizes directly.

    Args:
        processor: image processor of transformers.
    """
    picture = np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
    return network_input(processor, [picture], "whole")


def network_input(processor: Any, pictures: Sequence[Picture], fit: Fit) -> Tensor:
    """(N, 3, h, w) float32: what a network is given of pictures of any sizes.

    Args:
        processor: image processor of transformers.
        fit: `whole`: resized to the network's size, nothing is cut, the ratio of sides is lost;
            `published`: as the processor does, CLIP's resizes the shorter side and cuts the middle
            out; `padded`: padded to a square with the processor's mean colour, then as `whole`.
    """
    if fit == "padded":
        pictures = [padded_square(picture, mean_colour(processor)) for picture in pictures]
    options: dict[str, Any] = {}
    if fit != "published":
        options = {"do_resize": True, "size": input_size(processor), "do_center_crop": False}
    images = [Image.fromarray(picture) for picture in pictures]
    pixels: Tensor = processor(images=images, return_tensors="pt", **options)["pixel_values"]
    return pixels.float()


def input_size(processor: Any) -> dict[str, int]:
    """Height and width of what a processor of transformers gives."""
    size = processor.crop_size if processor.do_center_crop else processor.size
    edge = size.get("shortest_edge")
    return {side: edge or size[side] for side in ("height", "width")}


def mean_colour(processor: Any) -> Picture:
    """(3,) the colour that an image processor takes for the mean, rounded down as VQAScore does."""
    return (np.asarray(processor.image_mean) * 255).astype(np.uint8)


def square_crop(
    image: Picture,
    rectangle: tuple[float, float, float, float],
    colour: Picture,
    grow: float = 0.1,
    mask: NDArray[np.bool_] | None = None,
) -> Picture:
    """(S, S, 3) the square about a rectangle, which is wholly in it.

    The rectangle is grown, made square about its centre and rounded outwards to whole pixels. What
    lies beyond the image gets the colour, so that crops at the edge keep their place and scale.

    Args:
        image: (H, W, 3).
        rectangle: left, top, right, bottom in pixels; it may reach beyond the image.
        colour: (3,), see `mean_colour`.
        grow: share of its width and height by which the rectangle grows on every side.
        mask: (H, W); pixels outside of it get the colour too.

    Raises:
        ValueError: the rectangle is empty or not finite, or its square is larger than 8192 pixels.
    """
    low, high = np.asarray(rectangle[:2], np.float64), np.asarray(rectangle[2:], np.float64)
    half = (0.5 + grow) * float(np.max(high - low))
    if not (np.isfinite(half) and np.all(high > low) and 2 * half < MOST_PIXELS):
        raise ValueError(f"square_crop: rectangle {rectangle} of an image {image.shape[:2]}")
    first = np.floor((low + high) / 2 - half).astype(int)
    side = int(np.max(np.ceil((low + high) / 2 + half).astype(int) - first))
    if mask is not None:
        image = np.where(mask[..., None], image, colour)
    return _on_square(image, int(first[0]), int(first[1]), side, colour)


def padded_square(image: Picture, colour: Picture) -> Picture:
    """(S, S, 3) an image (H, W, 3) in the middle of a square of its longer side."""
    height, width = image.shape[:2]
    side = max(height, width)
    return _on_square(image, -((side - width) // 2), -((side - height) // 2), side, colour)


def _on_square(image: Picture, left: int, top: int, side: int, colour: Picture) -> Picture:
    """What an image shows from a column and row on, the colour where it shows nothing."""
    square = np.empty((side, side, 3), np.uint8)
    square[:] = colour
    part = image[max(top, 0) : max(top + side, 0), max(left, 0) : max(left + side, 0)]
    down, right = max(-top, 0), max(-left, 0)
    square[down : down + part.shape[0], right : right + part.shape[1]] = part
    return square


def resized(
    pictures: Sequence[Picture | NDArray[np.float64]], side: int, antialias: bool = False
) -> Tensor:
    """(N, 3, side, side) float32 in [0, 1]: pictures of any sizes, resized bilinearly on the CPU.

    The ratio of their sides is lost.

    Args:
        pictures: (H, W, 3), uint8 or floats in [0, 1].
        antialias: whether the filter widens where a picture shrinks.
    """
    made = []
    for one in pictures:
        pixels = torch.from_numpy(np.ascontiguousarray(one, np.float32)).movedim(-1, 0)[None]
        pixels = pixels / 255 if one.dtype == np.uint8 else pixels
        made.append(functional.interpolate(pixels, side, mode="bilinear", antialias=antialias))
    return torch.cat(made)


@torch.no_grad()
def in_batches(
    compute: Callable[[Sequence[Item]], Tensor],
    items: Sequence[Item],
    width: int,
    size: int = BATCH,
) -> NDArray[np.float64]:
    """(N, width) what `compute` makes of N items, which it gets in order, `size` at a time.

    The last bits of a row depend on how many items were computed with it, on the number of torch's
    threads and on the machine. Work that several processes share therefore gives the same bytes for
    any number of them only if each call gets the items of a fixed unit (such as one rollout) in a
    fixed order with one `size`, and every process has the same number of threads.

    Args:
        compute: function from at most `size` items to (n, width), on any device.
    """
    rows = np.empty((len(items), width))
    for start in range(0, len(items), size):
        rows[start : start + size] = compute(items[start : start + size]).double().cpu().numpy()
    return rows
