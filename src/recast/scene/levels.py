"""Training views at the resolutions of a run: kept small, laid out for the losses when in turn.

A view waits with 3 bytes a pixel of colour, one bit a pixel for each mask, and 8 bytes a depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.arrays import Mask
from recast.cameras import PinholeCamera
from recast.scene.config import SceneConfig
from recast.scene.first_points import near_samples
from recast.scene.initialise import Initialisation
from recast.scene.points import DepthSamples
from recast.scene.views import TrainingView

MAX_DEPTHS = 12_000


@dataclass(frozen=True)
class Level:
    """What the losses of one view need.

    Attributes:
        camera: intrinsics at this resolution.
        K: (3, 3) float32, on the CPU, where its numbers are read.
        target: (H, W, 3) float32 in [0, 1], unusable pixels black.
        usable: (H, W, 1) float32 0 or 1, or None where every pixel counts.
        sky: (S,) int64 flat indices of sure sky pixels.
        ground: (G,) int64 flat indices of pixels that are surely none, where a loss asks for them.
        depth_pixels: (M,) int64 flat indices; depths: (M,) float32 metres.
    """

    camera: PinholeCamera
    K: Tensor
    target: Tensor
    usable: Tensor | None
    sky: Tensor
    ground: Tensor
    depth_pixels: Tensor
    depths: Tensor


@dataclass(frozen=True)
class StoredLevel:
    """A level that waits: `unpacked` gives its tensors.

    Attributes:
        camera: intrinsics at this resolution.
        image: (H, W, 3) uint8.
        usable, sky, ground: masks of H W pixels as bits; see `Level`.
        depth_pixels: (M,) int32; depths: (M,) float32.
    """

    camera: PinholeCamera
    image: NDArray[np.uint8]
    usable: NDArray[np.uint8] | None
    sky: NDArray[np.uint8]
    ground: NDArray[np.uint8]
    depth_pixels: NDArray[np.int32]
    depths: NDArray[np.float32]

    def unpacked(self, device: torch.device | str = "cpu") -> Level:
        """The level on a device; a few float images, to be dropped after the step."""
        target = torch.from_numpy(self.image).to(device).to(torch.float32) * (1 / 255)
        usable = None
        if self.usable is not None:
            bits = self._unpacked(self.usable).reshape(self.camera.height, self.camera.width, 1)
            usable = torch.from_numpy(bits).to(device).to(torch.float32)
            target = target * usable
        return Level(
            camera=self.camera,
            K=torch.from_numpy(self.camera.matrix).float(),
            target=target,
            usable=usable,
            sky=torch.from_numpy(np.flatnonzero(self._unpacked(self.sky))).to(device),
            ground=torch.from_numpy(np.flatnonzero(self._unpacked(self.ground))).to(device),
            depth_pixels=torch.from_numpy(self.depth_pixels).to(device).to(torch.int64),
            depths=torch.from_numpy(self.depths).to(device),
        )

    def _unpacked(self, bits: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return np.unpackbits(bits, count=min(8 * len(bits), self.camera.width * self.camera.height))


def make_level(
    view: TrainingView, sky: Mask, ground: Mask | None, samples: DepthSamples, factor: int = 1
) -> StoredLevel:
    """The view with width and height divided by `factor`.

    Args:
        sky, ground: (H, W) masks of the view; no ground is kept where it is None.
        samples: LiDAR depths, thinned evenly to `MAX_DEPTHS`.
    """
    camera, image, usable, uv = view.camera, view.image, view.mask, samples.uv
    if factor > 1:
        width, height = max(1, camera.width // factor), max(1, camera.height // factor)
        size = (width, height)
        uv = uv * np.array([width / camera.width, height / camera.height], np.float32)
        camera = camera.resized(width, height)
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        usable = None if usable is None else _wholly(usable, size)
        sky = _wholly(sky, size)
        ground = None if ground is None else _wholly(ground, size)
    step = max(1, -(-len(samples.depths) // MAX_DEPTHS))
    uv, depths = uv[::step], samples.depths[::step]
    columns = np.minimum(uv[:, 0].astype(np.int32), camera.width - 1)
    rows = np.minimum(uv[:, 1].astype(np.int32), camera.height - 1)
    return StoredLevel(
        camera=camera,
        image=image,
        usable=None if usable is None else np.packbits(usable),
        sky=np.packbits(sky),
        ground=np.zeros(0, np.uint8) if ground is None else np.packbits(ground),
        depth_pixels=rows * np.int32(camera.width) + columns,
        depths=np.ascontiguousarray(depths),
    )


def _wholly(mask: Mask, size: tuple[int, int]) -> Mask:
    """Pixels of the smaller image that lie in the mask altogether."""
    area = cv2.resize(mask.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA)
    return area == 255


def make_levels(
    config: SceneConfig, views: Sequence[TrainingView], start: Initialisation
) -> dict[int, list[StoredLevel]]:
    """By factor of `schedule.coarse_factor`, the training views in order."""
    factors = set(config.coarse_factors) if config.coarse_fraction > 0 else set()
    levels: dict[int, list[StoredLevel]] = {factor: [] for factor in sorted(factors | {1})}
    for view, pixels, samples in zip(views, start.sky_pixels, start.depths, strict=True):
        sky = np.zeros((view.camera.height, view.camera.width), bool)
        sky.reshape(-1)[pixels] = True
        ground = _ground(config, view, sky, samples)
        for factor, own in levels.items():
            own.append(make_level(view, sky, ground, samples, factor))
    return levels


def _ground(
    config: SceneConfig, view: TrainingView, sky: Mask, samples: DepthSamples
) -> Mask | None:
    """Pixels that are surely no sky: all others, as far as they count.

    The guessed sky errs on the small side; then only pixels near a LiDAR return are sure.
    """
    if config.sky_loss != "entropy" and config.solid_weight == 0:
        return None
    ground = ~sky if view.mask is None else view.mask & ~sky
    return ground & near_samples(view, samples) if config.sky_mask == "heuristic" else ground
