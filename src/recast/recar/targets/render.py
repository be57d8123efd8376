"""Renders of targets, and pictures of vehicles, as square cut-outs of one scale."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from recast.geometry import se3
from recast.recar.camera import camera_pose, pinhole
from recast.recar.picture import Image
from recast.recar.targets.views import Viewpoint
from recast.splats import MIP, Gaussians, rasterize

FloatImage = NDArray[np.float32]

MARGIN = 1.2
"""Side of a cut-out over the longer side of the vehicle's box, as in the crops of the model."""

_OPAQUE = 0.5
_PSNR_RANGE = (5.0, 25.0)


@dataclass(frozen=True)
class Cutout:
    """A square picture of a vehicle.

    Attributes:
        rgb: (S, S, 3) float32 in [0, 1], times alpha: on black.
        alpha: (S, S) float32 in [0, 1].
    """

    rgb: FloatImage
    alpha: FloatImage

    @property
    def mask(self) -> NDArray[np.bool_]:
        """(S, S) where the vehicle is."""
        return np.asarray(self.alpha > _OPAQUE)

    def before(self, grey: float) -> Image:
        """(S, S, 3) uint8 before a grey background."""
        shown = self.rgb + grey * (1.0 - self.alpha[..., None])
        return np.rint(np.clip(shown, 0, 1) * 255).astype(np.uint8)


def iou(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> float:
    """Intersection over union of two masks; 0 where both are empty."""
    union = np.count_nonzero(first | second)
    return float(np.count_nonzero(first & second) / union) if union else 0.0


def closeness(first: Cutout, second: Cutout) -> float:
    """PSNR in dB of the colours where either shows the vehicle, from 5 to 25 dB as 0 to 1."""
    seen = first.mask | second.mask
    if not seen.any():
        return 0.0
    error = float(np.mean(np.square(first.rgb[seen] - second.rgb[seen])))
    low, high = _PSNR_RANGE
    return float(np.clip((-10.0 * np.log10(max(error, 1e-6)) - low) / (high - low), 0, 1))


def render(gaussians: Gaussians, viewpoint: Viewpoint, pixels: int) -> Cutout:
    """A square render of an asset in the unit cube, with the filter of the published renderer.

    Args:
        gaussians: z up, about the origin.
        viewpoint: place of the camera, its azimuth from +x.
        pixels: side of the picture.
    """
    camera = pinhole(pixels, pixels, viewpoint.fov_deg)
    pose = camera_pose(viewpoint.azimuth_deg, viewpoint.elevation_deg, viewpoint.distance)
    with torch.no_grad():
        made = rasterize(
            gaussians, torch.from_numpy(se3.inverse(pose)).float(),
            torch.from_numpy(camera.matrix).float(), pixels, pixels,
            eps2d=MIP.variance, antialiased=MIP.antialiased,
        )  # fmt: skip
    return Cutout(made.rgb.clamp(0, 1).numpy(), made.alpha.clamp(0, 1).numpy())


def of_picture(rgba: Image) -> Cutout:
    """A picture (H, W, 4) with straight alpha, made square by transparent borders."""
    height, width = rgba.shape[:2]
    side = max(height, width)
    top, left = (side - height) // 2, (side - width) // 2
    values = np.zeros((side, side, 4), np.float32)
    values[top : top + height, left : left + width] = rgba.astype(np.float32) / 255
    return Cutout(values[..., :3] * values[..., 3:], values[..., 3])


def resized(cutout: Cutout, pixels: int) -> Cutout:
    """The whole of a square picture at another size."""
    if len(cutout.alpha) == pixels:
        return cutout
    method = cv2.INTER_AREA if len(cutout.alpha) > pixels else cv2.INTER_LINEAR
    values: Any = np.dstack([cutout.rgb, cutout.alpha])
    values = cv2.resize(values, (pixels, pixels), interpolation=method)
    return Cutout(np.ascontiguousarray(values[..., :3]), np.ascontiguousarray(values[..., 3]))


def framed(cutout: Cutout, pixels: int) -> Cutout:
    """The square around the vehicle at a scale of its own, so that size and place do not matter.

    Args:
        cutout: of any size; empty ones stay as they are.
        pixels: side of the result.
    """
    rows, columns = np.nonzero(cutout.mask)
    if len(rows) == 0:
        return Cutout(
            np.zeros((pixels, pixels, 3), np.float32), np.zeros((pixels,) * 2, np.float32)
        )
    extent = max(np.ptp(rows), np.ptp(columns)) + 1
    scale = pixels / (MARGIN * extent)
    centre = np.array([columns.min() + columns.max() + 1, rows.min() + rows.max() + 1]) / 2
    values: Any = np.dstack([cutout.rgb, cutout.alpha])
    if scale < 1:  # smooth before shrinking, so that no pixel is skipped
        sigma = 0.35 / scale
        values = cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
    # Pixel centres are at +0.5 in both frames; OpenCV's are at whole numbers.
    shift = pixels / 2 - scale * centre
    affine = np.array([[scale, 0, shift[0] + 0.5 * scale - 0.5],
                       [0, scale, shift[1] + 0.5 * scale - 0.5]])  # fmt: skip
    values = cv2.warpAffine(values, affine, (pixels, pixels), flags=cv2.INTER_LINEAR)
    return Cutout(np.ascontiguousarray(values[..., :3]), np.ascontiguousarray(values[..., 3]))
