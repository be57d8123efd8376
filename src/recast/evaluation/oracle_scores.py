"""How alike a drawn vehicle and the true one are, within the vehicle's box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from recast.geometry import PinholeCamera, boxes
from recast.scene import SceneActor, psnr
from recast.scene.image_metrics import ssim_map
from recast.splats import rasterize

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Rectangle = tuple[int, int, int, int]
"""Left, top, right, bottom in whole pixels; right and bottom are one past the last."""

PSNR_CAP = 100.0
"""dB given to images that are equal; JSON knows no infinity."""


@dataclass(frozen=True)
class Agreement:
    """An arm's image against the truth's.

    Attributes:
        psnr: dB inside the rectangle, at most 100.
        ssim: mean over the rectangle.
        mask_iou: intersection over union of the vehicle's outlines, over the whole image.
    """

    psnr: float
    ssim: float
    mask_iou: float


def box_pixels(
    size: ArrayLike, camera_from_actor: Array, camera: PinholeCamera
) -> Rectangle | None:
    """The projected box's rectangle, clipped to the image; None where less than half is in it."""
    outline = boxes.project(size, camera_from_actor, camera)
    if outline is None:
        return None
    limits = [camera.width, camera.height, camera.width, camera.height]
    inside = np.clip(outline, 0, limits)
    width, height = inside[2:] - inside[:2]
    if width * height < 0.5 * np.prod(outline[2:] - outline[:2]) or min(width, height) < 1:
        return None
    left, top = (int(v) for v in np.floor(inside[:2]))
    right, bottom = (int(v) for v in np.ceil(inside[2:]))
    return left, top, right, bottom


def grown(rectangle: Rectangle, margin: int, width: int, height: int) -> Rectangle:
    """The rectangle with `margin` more pixels on every side that has them."""
    left, top, right, bottom = rectangle
    return (
        max(left - margin, 0),
        max(top - margin, 0),
        min(right + margin, width),
        min(bottom + margin, height),
    )


def agreement(
    image: Image, truth: Image, rectangle: Rectangle, mask: Mask, true_mask: Mask
) -> Agreement:
    """Score one view.

    SSIM is the mean over the rectangle of the map computed on all that is given: its 11 x 11
    windows look beyond the rectangle's edge, so that a rectangle may be smaller than a window.

    Args:
        image, truth: (H, W, 3) uint8, the rectangle and what surrounds it.
        rectangle: in pixels of these.
        mask, true_mask: bool of one shape, of any extent that holds both outlines.

    Raises:
        ValueError: the rectangle holds no pixel.
    """
    left, top, right, bottom = rectangle
    if left >= right or top >= bottom:
        raise ValueError(f"agreement: no pixel in the rectangle {rectangle}")
    inside = (slice(top, bottom), slice(left, right))
    drawn, wanted = image.astype(np.float64) / 255, truth.astype(np.float64) / 255
    similarity = ssim_map(torch.from_numpy(drawn), torch.from_numpy(wanted)).numpy()
    return Agreement(
        psnr=min(psnr(drawn[inside], wanted[inside]), PSNR_CAP),
        ssim=float(similarity[inside].mean()),
        mask_iou=mask_iou(mask, true_mask),
    )


def mask_iou(mask: Mask, true_mask: Mask) -> float:
    """Intersection over union; 1 where both are empty."""
    union = int((mask | true_mask).sum())
    return int((mask & true_mask).sum()) / union if union else 1.0


def actor_mask(
    actor: SceneActor, camera: PinholeCamera, camera_from_world: Array, world_from_actor: Array
) -> Mask:
    """Pixels (H, W) that a vehicle drawn alone, without its shadow, covers by more than half."""
    with torch.no_grad():
        alone = rasterize(
            actor.gaussians.detach().transformed(torch.from_numpy(world_from_actor)),
            torch.from_numpy(np.asarray(camera_from_world)).float(),
            torch.from_numpy(camera.matrix).float(),
            camera.width,
            camera.height,
            eps2d=actor.low_pass.variance,
            antialiased=actor.low_pass.antialiased,
        )
    covered: Mask = alone.alpha.numpy() > 0.5
    return covered
