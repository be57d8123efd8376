"""The pictures of a vehicle beside the renders of its target: four views, cut-outs, heading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from recast.arrays import Image
from recast.core.errors import InputError
from recast.geometry import se3
from recast.recar.target_cache import VIEWS_DEG
from recast.recar.vehicle_set import Identity, SetRecord
from recast.recar.views import ELEVATION_DEG, FOV_DEG, camera_pose, decode_picture, pinhole
from recast.splats import MIP, Gaussians, rasterize

FARTHEST_DEG = 22.5
"""A picture farther than this from front, rear, left or right does not stand for it."""

_DISTANCE = 2.0  # of the published camera helper, in units of the vehicle's longest side
FloatImage = NDArray[np.float32]

MARGIN = 1.2
"""Side of a cut-out over the longer side of the vehicle's box, as in the crops of the model."""

_OPAQUE = 0.5
_PSNR_RANGE = (5.0, 25.0)
STEPS = 24
"""Headings that are tried around the circle, 15 degrees apart."""

WITHIN_DEG = 1.0
"""Largest last step: the best of them is then moved by ever smaller ones."""

_PIXELS = 64  # side of the cut-outs that are compared


def nearest_views(record: SetRecord) -> tuple[int, ...]:
    """Views nearest to front, rear, left and right, in this order; the first of equally near ones.

    Raises:
        InputError: the set has no view within 22.5 degrees of one of them.
    """
    azimuths = np.array(record.azimuths_deg)
    chosen = []
    for wanted in VIEWS_DEG:
        error = np.abs((azimuths - wanted + 180.0) % 360.0 - 180.0)
        index = int(np.argmin(np.round(error, 6)))
        if error[index] > FARTHEST_DEG:
            problem = f"no view is within {FARTHEST_DEG:g} degrees of {wanted:g}"
            mend = "add views: targets need the front, rear, left and right"
            raise InputError(record.name, "azimuths", problem, mend)
        chosen.append(index)
    return tuple(chosen)


@dataclass(frozen=True)
class Viewpoint:
    """Where a picture was taken from, in units of the vehicle's longest side.

    Attributes:
        azimuth_deg, elevation_deg: azimuth and elevation of the camera; 0 degrees ahead, 90 to the
            left.
        fov_deg: angle of view across the picture.
        distance: distance from the middle of the vehicle.
    """

    azimuth_deg: float
    elevation_deg: float = ELEVATION_DEG
    fov_deg: float = FOV_DEG
    distance: float = _DISTANCE


@dataclass(frozen=True)
class EncodedView:
    """A picture that has not been decoded, the size that it must have, and its viewpoint."""

    name: str
    png: bytes
    width: int
    height: int
    viewpoint: Viewpoint

    def picture(self) -> Image:
        """(height, width, 4) uint8 RGBA with straight alpha.

        Raises:
            InputError: the picture is broken.
        """
        return decode_picture(self.png, self.name, self.width, self.height)


def encoded_view(identity: Identity, index: int) -> EncodedView:
    """A view of a vehicle with its viewpoint; what the set did not measure is as by default.

    Raises:
        InputError: the file is missing.
    """
    shared, own = identity.set_record, identity.record
    elevation = ELEVATION_DEG if shared.elevation_deg is None else shared.elevation_deg
    viewpoint = Viewpoint(shared.azimuths_deg[index], elevation)
    if shared.fov_deg is not None and own.distance_m is not None and own.size is not None:
        distance = own.distance_m / max(own.size)
        viewpoint = Viewpoint(shared.azimuths_deg[index], elevation, shared.fov_deg, distance)
    return EncodedView(
        f"view {index}", identity.encoded(index), shared.width, shared.height, viewpoint
    )


@dataclass(frozen=True)
class TargetCutout:
    """A square picture of a vehicle.

    Attributes:
        rgb: (S, S, 3) float32 colours in [0, 1], times alpha: on black.
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


def closeness(first: TargetCutout, second: TargetCutout) -> float:
    """PSNR in dB of the colours where either shows the vehicle, from 5 to 25 dB as 0 to 1."""
    seen = first.mask | second.mask
    if not seen.any():
        return 0.0
    error = float(np.mean(np.square(first.rgb[seen] - second.rgb[seen])))
    low, high = _PSNR_RANGE
    return float(np.clip((-10.0 * np.log10(max(error, 1e-6)) - low) / (high - low), 0, 1))


def render(gaussians: Gaussians, viewpoint: Viewpoint, pixels: int) -> TargetCutout:
    """A square render of an asset in the unit cube, z up, with the published renderer's filter.

    It is about the origin; azimuths are from +x; `pixels` is the side of the picture.
    """
    camera = pinhole(pixels, pixels, viewpoint.fov_deg)
    pose = camera_pose(viewpoint.azimuth_deg, viewpoint.elevation_deg, viewpoint.distance)
    with torch.no_grad():
        made = rasterize(
            gaussians,
            torch.from_numpy(se3.inverse(pose)).float(),
            torch.from_numpy(camera.matrix).float(),
            pixels,
            pixels,
            eps2d=MIP.variance,
            antialiased=MIP.antialiased,
        )
    return TargetCutout(made.rgb.clamp(0, 1).numpy(), made.alpha.clamp(0, 1).numpy())


def of_picture(rgba: Image) -> TargetCutout:
    """A picture (H, W, 4) with straight alpha, made square by transparent borders."""
    height, width = rgba.shape[:2]
    side = max(height, width)
    top, left = (side - height) // 2, (side - width) // 2
    values = np.zeros((side, side, 4), np.float32)
    values[top : top + height, left : left + width] = rgba.astype(np.float32) / 255
    return TargetCutout(values[..., :3] * values[..., 3:], values[..., 3])


def resized(cutout: TargetCutout, pixels: int) -> TargetCutout:
    """The whole of a square picture at another size."""
    if len(cutout.alpha) == pixels:
        return cutout
    method = cv2.INTER_AREA if len(cutout.alpha) > pixels else cv2.INTER_LINEAR
    values: Any = np.dstack([cutout.rgb, cutout.alpha])
    values = cv2.resize(values, (pixels, pixels), interpolation=method)
    return TargetCutout(np.ascontiguousarray(values[..., :3]), np.ascontiguousarray(values[..., 3]))


def framed(cutout: TargetCutout, pixels: int) -> TargetCutout:
    """The square around the vehicle at a scale of its own, so that size and place do not matter.

    Args:
        cutout: cutout of any size; empty ones stay as they are.
        pixels: side of the result in pixels.
    """
    rows, columns = np.nonzero(cutout.mask)
    if len(rows) == 0:
        return TargetCutout(
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
    affine = np.array(
        [[scale, 0, shift[0] + 0.5 * scale - 0.5], [0, scale, shift[1] + 0.5 * scale - 0.5]]
    )
    values = cv2.warpAffine(values, affine, (pixels, pixels), flags=cv2.INTER_LINEAR)
    return TargetCutout(np.ascontiguousarray(values[..., :3]), np.ascontiguousarray(values[..., 3]))


def find_heading(
    gaussians: Gaussians, pictures: Sequence[Image], viewpoints: Sequence[Viewpoint]
) -> float:
    """Degrees in [0, 360) about z, from +x, to which the vehicle's front points.

    The heading under which renders agree best with all pictures, in outline and in colours. Both
    are cut out at one scale, so that size and place of the asset do not matter. Where a vehicle
    looks alike from several sides, such as front and rear, any of them may come out; its agreement
    is then alike too.

    Args:
        gaussians: Gaussians of the target, in the unit cube, z up.
        viewpoints: viewpoints that the pictures were taken from, azimuth 0 ahead of the vehicle.
    """
    wanted = [framed(of_picture(picture), _PIXELS) for picture in pictures]

    @cache  # views a quarter apart see the same pictures, one after the other
    def shown(viewpoint: Viewpoint) -> TargetCutout:
        return framed(render(gaussians, viewpoint, 2 * _PIXELS), _PIXELS)

    def agreement(heading: float) -> float:
        seen = [shown(turned(view, heading)) for view in viewpoints]
        return float(
            np.mean(
                [iou(a.mask, b.mask) + closeness(a, b) for a, b in zip(wanted, seen, strict=True)]
            )
        )

    step = 360.0 / STEPS
    best = max((step * index for index in range(STEPS)), key=agreement)
    while step > WITHIN_DEG:
        step /= 2
        best = max((best, best - step, best + step), key=agreement)
    return best % 360.0


def turned(viewpoint: Viewpoint, heading_deg: float) -> Viewpoint:
    """The viewpoint in the frame of an asset whose front points to `heading_deg`."""
    return replace(viewpoint, azimuth_deg=(viewpoint.azimuth_deg + heading_deg) % 360.0)
