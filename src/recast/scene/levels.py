"""One training view at one resolution, ready to be compared with a rendering."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.geometry import PinholeCamera
from recast.scene.lidar import DepthSamples
from recast.scene.views import View

MAX_DEPTHS = 12_000


@dataclass(frozen=True)
class Level:
    """What the losses of one view need.

    Attributes:
        camera: intrinsics at this resolution.
        K: (3, 3) float32.
        image: (H, W, 3) uint8.
        usable: (H, W, 1) float32 0 or 1, or None where every pixel counts.
        sky: (S,) int64 flat indices of sure sky pixels.
        depth_pixels: (M,) int64 flat indices; depths: (M,) float32 metres.
    """

    camera: PinholeCamera
    K: Tensor
    image: Tensor
    usable: Tensor | None
    sky: Tensor
    depth_pixels: Tensor
    depths: Tensor

    def to(self, device: torch.device | str) -> Level:
        """The same on another device, but for `K`, whose numbers are read on the CPU."""
        return replace(
            self,
            image=self.image.to(device),
            usable=None if self.usable is None else self.usable.to(device),
            sky=self.sky.to(device),
            depth_pixels=self.depth_pixels.to(device),
            depths=self.depths.to(device),
        )

    @property
    def target(self) -> Tensor:
        """The image as float32 in [0, 1], unusable pixels black."""
        target = self.image.to(torch.float32) * (1 / 255)
        return target if self.usable is None else target * self.usable


def full_level(view: View, sky_pixels: NDArray[np.int64], samples: DepthSamples) -> Level:
    """The view as it is, its depth samples thinned evenly to `MAX_DEPTHS`."""
    return _level(view.camera, view.image, view.mask, sky_pixels, samples)


def half_level(view: View, sky_pixels: NDArray[np.int64], samples: DepthSamples) -> Level:
    """The view at half the width and height."""
    camera = view.camera
    width, height = max(1, camera.width // 2), max(1, camera.height // 2)
    size = (width, height)
    sky = np.zeros(camera.height * camera.width, bool)
    sky[sky_pixels] = True
    small_sky = _wholly(sky.reshape(camera.height, camera.width), size)
    uv = samples.uv * np.array([width / camera.width, height / camera.height], np.float32)
    return _level(
        camera.resized(width, height),
        np.asarray(cv2.resize(view.image, size, interpolation=cv2.INTER_AREA), np.uint8),
        None if view.mask is None else _wholly(view.mask, size),
        np.flatnonzero(small_sky),
        DepthSamples(samples.depths, uv),
    )


def _wholly(mask: NDArray[np.bool_], size: tuple[int, int]) -> NDArray[np.bool_]:
    """Pixels of the smaller image that lie in the mask altogether."""
    area = cv2.resize(mask.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA)
    whole: NDArray[np.bool_] = area == 255
    return whole


def _level(
    camera: PinholeCamera,
    image: NDArray[np.uint8],
    mask: NDArray[np.bool_] | None,
    sky: NDArray[np.int64],
    samples: DepthSamples,
) -> Level:
    step = max(1, -(-len(samples.depths) // MAX_DEPTHS))
    uv, depths = samples.uv[::step], samples.depths[::step]
    columns = np.minimum(uv[:, 0].astype(np.int64), camera.width - 1)
    rows = np.minimum(uv[:, 1].astype(np.int64), camera.height - 1)
    return Level(
        camera=camera,
        K=torch.from_numpy(camera.matrix).float(),
        image=torch.from_numpy(image),
        usable=None if mask is None else torch.from_numpy(mask[..., None].astype(np.float32)),
        sky=torch.from_numpy(sky),
        depth_pixels=torch.from_numpy(rows * camera.width + columns),
        depths=torch.from_numpy(np.ascontiguousarray(depths)),
    )
