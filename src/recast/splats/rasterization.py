"""What `rasterize` takes and gives: the result types and the checks on its arguments."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from recast.splats.gaussians import Gaussians

ALPHA_THRESHOLD = 1.0 / 255.0
"""A Gaussian that covers a pixel by less than this does not touch it."""
TRANSMITTANCE_THRESHOLD = 1e-4
"""A pixel is finished before the Gaussian that would bring its transmittance to this or below."""
LARGEST_DETERMINANT = 1e30
"""A Gaussian whose covariance in the image has this determinant or more, px^4, is not drawn."""
LARGEST_PIXELS = 1e30
"""Bound of focal lengths and centres in pixels, which must be numbers of float32."""
TILE = 16
"""Edge of a tile, pixels."""
TANGENT_MARGIN = 0.3
"""The Jacobian is taken no farther outside the image than this part of the half field of view."""


Window = tuple[int, int, int, int]
"""Left, top, right and bottom edge of a part of an image, pixels."""


@dataclass
class RasterMeta:
    """Per-Gaussian facts of one rasterization, for densification and sparse optimisers.

    Attributes:
        visible: (N,) bool, touched the image.
        radii: (N,) float32, half the longer edge of the bounding box, pixels, rounded up; 0 where
            not visible.
        means2d: (N, 2) projected centres, pixels of the whole image; 0 where not visible.
        means2d_grad: (N, 2) d loss / d means2d, per pixel; None before the backward pass.
        means2d_absgrad: (N, 2) likewise, but the sizes of what the pixels contribute added up, each
            component by itself (AbsGS); None where it was not asked for.
    """

    visible: Tensor
    radii: Tensor
    means2d: Tensor
    means2d_grad: Tensor | None = None
    means2d_absgrad: Tensor | None = None


@dataclass(frozen=True)
class RasterImages:
    """One rendered view.

    Attributes:
        rgb: (H, W, 3) colour, composited over the background where one is given; not clamped.
        depth: (H, W) sum of T alpha z, metres, not divided by alpha.
        alpha: (H, W) accumulated opacity.
    """

    rgb: Tensor
    depth: Tensor
    alpha: Tensor


@dataclass(frozen=True)
class Rasterization(RasterImages):
    """One rendered view, with per-Gaussian facts in `meta`."""

    meta: RasterMeta


@dataclass(frozen=True)
class RasterSettings:
    """The numbers of one view besides poses and Gaussians; raises ValueError for one at fault.

    Attributes:
        width, height: size of the whole image.
        window: the part of it that is drawn; None for all of it.
        others: as of `rasterize`.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    near: float
    far: float
    eps2d: float
    antialiased: bool
    max_alpha: float
    absgrad: bool = False
    window: Window | None = None

    @property
    def drawn(self) -> Window:
        """The part of the whole image that is drawn."""
        return (0, 0, self.width, self.height) if self.window is None else self.window

    def __post_init__(self) -> None:
        if not (0 < self.width <= 65536 and 0 < self.height <= 65536):
            raise ValueError(f"rasterize: image of {self.width}x{self.height} pixels")
        left, top, right, bottom = self.drawn
        if not (0 <= left < right <= self.width and 0 <= top < bottom <= self.height):
            size = f"{self.width}x{self.height}"
            raise ValueError(f"rasterize: window {self.drawn} is not a part of {size} pixels")
        if not 0 < self.near < self.far:
            near_and_far = f"near {self.near} and far {self.far}"
            raise ValueError(f"rasterize: {near_and_far}, expected 0 < near < far")
        if not (self.eps2d >= 0 and math.isfinite(self.eps2d)):
            raise ValueError(f"rasterize: eps2d {self.eps2d}, expected a number >= 0")
        if not ALPHA_THRESHOLD < self.max_alpha < 1:
            raise ValueError(f"rasterize: max_alpha {self.max_alpha}, expected between 1/255 and 1")


def check_settings(
    camera_from_world: Tensor, K: Tensor, background: Tensor | None, **numbers: Any
) -> RasterSettings:
    """Check the view; `numbers` are the other members of its settings.

    Raises:
        ValueError: names the argument at fault.
    """
    check_pose(camera_from_world)
    if tuple(K.shape) != (3, 3):
        raise ValueError(f"rasterize: K: shape {tuple(K.shape)}, expected (3, 3)")
    (fx, skew, cx), (_, fy, cy) = K.detach().double().cpu()[:2].tolist()
    fine = all(abs(v) < LARGEST_PIXELS for v in (fx, fy, cx, cy))  # not so NaN
    if not fine or min(fx, fy) < 1 / LARGEST_PIXELS:
        raise ValueError(
            f"rasterize: K: focal lengths {fx}, {fy}, centre {cx}, {cy} make no camera"
        )
    if skew != 0:
        raise ValueError(f"rasterize: K: skew {skew} is not supported")
    if background is not None and tuple(background.shape) != (3,):
        raise ValueError(f"rasterize: background: shape {tuple(background.shape)}, expected (3,)")
    return RasterSettings(fx, fy, cx, cy, **numbers)


def check_pose(pose: Tensor, name: str = "camera_from_world") -> None:
    """Raise ValueError unless a pose (4, 4) is a rigid transform."""
    if tuple(pose.shape) != (4, 4):
        raise ValueError(f"rasterize: {name}: shape {tuple(pose.shape)}, expected (4, 4)")
    pose = pose.detach().double().cpu()
    if not bool(torch.isfinite(pose).all()):
        raise ValueError(f"rasterize: {name} is not finite")
    rotation = pose[:3, :3]
    skewed = (rotation @ rotation.T - torch.eye(3, dtype=torch.float64)).abs().max() > 1e-3
    if skewed or pose[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        raise ValueError(f"rasterize: {name} is not a rigid transform")


def check_shapes(gaussians: Gaussians, device_type: str) -> None:
    """Check shapes, types and devices: the values are checked where they are read.

    Args:
        device_type: "cpu" or "cuda", where all fields must lie, on one device.

    Raises:
        ValueError: names the field at fault.
    """
    if gaussians.sh.ndim != 3 or gaussians.sh.shape[1] not in (1, 4, 9, 16):
        raise ValueError(
            f"Gaussians.sh: shape {tuple(gaussians.sh.shape)}, expected (N, 1|4|9|16, 3)"
        )
    for name, shape in gaussians.expected_shapes().items():
        value: Tensor = getattr(gaussians, name)
        if tuple(value.shape) != shape:
            raise ValueError(f"Gaussians.{name}: shape {tuple(value.shape)}, expected {shape}")
        if value.device.type != device_type or value.device != gaussians.means.device:
            wanted = gaussians.means.device if name != "means" else device_type
            raise ValueError(f"Gaussians.{name}: on {value.device}, expected on {wanted}")
        if value.dtype != gaussians.means.dtype or not value.is_floating_point():
            raise ValueError(
                f"Gaussians.{name}: dtype {value.dtype}, expected that of the means, floating point"
            )
