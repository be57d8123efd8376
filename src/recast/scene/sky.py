"""The sky: an equirectangular colour map at infinity, seen where Gaussians let light through."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

HEIGHT, WIDTH = 128, 512
OPAQUE = 1.0 - 1.0 / 255.0
"""Pixels more opaque than this show no sky: what is lost is below one grey level."""


@dataclass(frozen=True)
class SkyMap:
    """Colour by direction.

    Attributes:
        colours: (H, W, 3) float32 in [0, 1]. Rows run from the zenith down to the nadir, columns
            from azimuth -pi (counter-clockwise seen from above, 0 along world x) to pi, cell
            centres at +0.5; the first and the last column are neighbours.
    """

    colours: Tensor

    @classmethod
    def constant(cls, colour: Tensor, height: int = HEIGHT, width: int = WIDTH) -> SkyMap:
        """One colour (3,) everywhere."""
        return cls(colour.to(torch.float32).expand(height, width, 3).clone())

    def __call__(self, directions: Tensor) -> Tensor:
        """Colours (M, 3) in world directions (M, 3) of any length, bilinear."""
        cells, weights = bilinear_cells(directions, *self.colours.shape[:2])
        return _gather(self.colours.reshape(-1, 3), cells, weights)


def bilinear_cells(directions: Tensor, height: int, width: int) -> tuple[Tensor, Tensor]:
    """The four map cells around directions (M, 3): flat indices (4, M) and weights (4, M)."""
    x, y, z = directions.unbind(-1)
    azimuth = torch.atan2(y, x)
    elevation = torch.atan2(z, torch.sqrt(x * x + y * y))
    column = (azimuth + math.pi) * (width / (2 * math.pi)) - 0.5
    row = ((math.pi / 2 - elevation) * (height / math.pi) - 0.5).clamp(0, height - 1)
    left, top = column.floor(), row.floor().clamp(max=height - 2)
    right_weight, lower_weight = column - left, row - top
    left_index = left.long() % width
    right_index = (left_index + 1) % width
    top_index = top.long() * width
    cells = torch.stack(
        [
            top_index + left_index,
            top_index + right_index,
            top_index + width + left_index,
            top_index + width + right_index,
        ]
    )
    weights = torch.stack(
        [
            (1 - right_weight) * (1 - lower_weight),
            right_weight * (1 - lower_weight),
            (1 - right_weight) * lower_weight,
            right_weight * lower_weight,
        ]
    )
    return cells, weights


def _gather(colours: Tensor, cells: Tensor, weights: Tensor) -> Tensor:
    return (colours[cells] * weights[..., None]).sum(0)


class _Composite(torch.autograd.Function):
    """rgb + (1 - alpha) sky, looked up only where it shows."""

    @staticmethod
    def forward(
        ctx: Any, rgb: Tensor, alpha: Tensor, colours: Tensor, directions: Tensor
    ) -> Tensor:
        shown = (alpha.reshape(-1) < OPAQUE).nonzero()[:, 0]
        height, width = colours.shape[:2]
        cells, weights = bilinear_cells(directions.reshape(-1, 3)[shown], height, width)
        sky = _gather(colours.reshape(-1, 3), cells, weights)
        through = (1 - alpha.reshape(-1)[shown])[:, None]
        image = rgb.clone()
        image.view(-1, 3).index_add_(0, shown, through * sky)
        ctx.save_for_backward(shown, cells, weights, sky, through)
        ctx.shape = colours.shape
        return image

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor, Tensor, Tensor, None]:
        (gradient,) = grad_outputs
        shown, cells, weights, sky, through = ctx.saved_tensors
        rows = gradient.reshape(-1, 3)[shown]
        by_alpha = gradient.new_zeros(gradient.shape[0] * gradient.shape[1])
        by_alpha[shown] = -(rows * sky).sum(1)
        by_colour = gradient.new_zeros(ctx.shape[0] * ctx.shape[1], 3)
        scaled = rows * through
        for cell, weight in zip(cells, weights, strict=True):
            by_colour.index_add_(0, cell, scaled * weight[:, None])
        return gradient, by_alpha.view(gradient.shape[:2]), by_colour.view(ctx.shape), None


def composite(rgb: Tensor, alpha: Tensor, colours: Tensor, directions: Tensor) -> Tensor:
    """Put the sky behind a rendered image.

    Args:
        rgb: (H, W, 3) premultiplied colour on black.
        alpha: (H, W) accumulated opacity.
        colours: (h, w, 3) the sky map's.
        directions: (H, W, 3) world directions of the pixels.

    Returns:
        (H, W, 3), differentiable in all but the directions; pixels above `OPAQUE` are left alone.
    """
    image: Tensor = _Composite.apply(rgb, alpha, colours, directions)
    return image


def sky_from_pixels(
    directions: NDArray[np.float32],
    colours: NDArray[np.float32],
    height: int = HEIGHT,
    width: int = WIDTH,
) -> SkyMap:
    """A first map: the mean colour of the sky pixels seen in each cell, spread where none was.

    Args:
        directions, colours: (M, 3) of sky pixels over all images; none makes a light grey sky.
    """
    if len(directions) == 0:
        return SkyMap.constant(torch.full((3,), 0.8), height, width)
    cells, weights = bilinear_cells(torch.from_numpy(directions), height, width)
    nearest = cells.gather(0, weights.argmax(0, keepdim=True))[0].numpy()
    count = np.bincount(nearest, minlength=height * width).astype(np.float64)
    sums = [np.bincount(nearest, colours[:, c], minlength=height * width) for c in range(3)]
    total = np.stack(sums, axis=-1).astype(np.float64)
    filled = _spread(total.reshape(height, width, 3), count.reshape(height, width))
    return SkyMap(torch.from_numpy(filled.astype(np.float32)).clamp(0, 1))


def _spread(total: NDArray[np.float64], count: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normalised convolution with growing windows until every cell has a colour."""
    mean = total.reshape(-1, 3).sum(0) / count.sum()
    result = np.broadcast_to(mean, total.shape).copy()
    width = count.shape[1]
    sigma = max(count.shape) / 8
    while sigma > 0.3:
        pad = min(width, int(3 * sigma) + 1)
        wide_total = np.concatenate([total[:, -pad:], total, total[:, :pad]], axis=1)
        wide_count = np.concatenate([count[:, -pad:], count, count[:, :pad]], axis=1)
        blurred = cv2.GaussianBlur(wide_total, (0, 0), sigma)[:, pad : pad + width]
        weight = cv2.GaussianBlur(wide_count, (0, 0), sigma)[:, pad : pad + width]
        enough = weight > 0.3 * weight.max() * 1e-2
        result[enough] = (blurred / np.maximum(weight, 1e-12)[..., None])[enough]
        sigma /= 2
    seen = count > 0
    result[seen] = (total / np.maximum(count, 1)[..., None])[seen]
    return result
