"""PSNR and SSIM of images, in their plain form."""

from __future__ import annotations

import math
from functools import cache

import torch
import torch.nn.functional as functional
from numpy.typing import ArrayLike
from torch import Tensor

WINDOW = 11
SIGMA = 1.5
C1 = 0.01**2
C2 = 0.03**2


def psnr(image: ArrayLike | Tensor, reference: ArrayLike | Tensor) -> float:
    """Peak signal-to-noise ratio in dB: -10 log10 of the mean squared error.

    Args:
        image, reference: (..., 3), values in [0, 1], equal shapes.

    Returns:
        infinity for equal images.

    >>> round(psnr([[0.5]], [[0.4]]), 6)
    20.0
    """
    first, second = _as_tensor(image), _as_tensor(reference)
    _check_shapes(first, second)
    error = float((first - second).square().mean())
    return math.inf if error == 0.0 else -10.0 * math.log10(error)


def ssim(image: ArrayLike | Tensor, reference: ArrayLike | Tensor) -> float:
    """Mean structural similarity of two images (H, W, C) with values in [0, 1].

    See `ssim_map`. float64.
    """
    first, second = _as_tensor(image), _as_tensor(reference)
    _check_shapes(first, second)
    return float(ssim_map(first, second).mean())


def ssim_map(image: Tensor, reference: Tensor) -> Tensor:
    """Structural similarity at every pixel, (H, W, C), differentiable.

    (2 mx my + C1)(2 sxy + C2) / ((mx^2 + my^2 + C1)(sx^2 + sy^2 + C2)) with moments under an
    11 x 11 Gaussian window, sigma 1.5, zero padding, C1 = 0.01^2, C2 = 0.03^2 (Wang et al. 2004,
    eq. 13; the padding is 3D Gaussian splatting's).
    """
    x = image.movedim(-1, 0)[:, None]
    y = reference.movedim(-1, 0)[:, None]
    mx, my = _blur(x), _blur(y)
    sx, sy = _blur(x * x) - mx * mx, _blur(y * y) - my * my
    sxy = _blur(x * y) - mx * my
    similarity = ((2 * mx * my + C1) * (2 * sxy + C2)) / ((mx * mx + my * my + C1) * (sx + sy + C2))
    return similarity[:, 0].movedim(0, -1)


@cache
def window() -> Tensor:
    """The normalised one-dimensional Gaussian window (11,), float64."""
    offset = torch.arange(WINDOW, dtype=torch.float64) - WINDOW // 2
    weight = torch.exp(-0.5 * (offset / SIGMA) ** 2)
    return weight / weight.sum()


def _blur(planes: Tensor) -> Tensor:
    kernel = window().to(planes)
    half = WINDOW // 2
    rows = functional.conv2d(planes, kernel.view(1, 1, 1, -1), padding=(0, half))
    return functional.conv2d(rows, kernel.view(1, 1, -1, 1), padding=(half, 0))


def _as_tensor(image: ArrayLike | Tensor) -> Tensor:
    return torch.as_tensor(image).to(torch.float64)


def _check_shapes(first: Tensor, second: Tensor) -> None:
    if first.shape != second.shape:
        raise ValueError(f"images differ in shape: {tuple(first.shape)}, {tuple(second.shape)}")
