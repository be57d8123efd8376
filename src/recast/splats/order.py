"""Ordering Gaussians so that neighbours in space are neighbours in memory."""

from __future__ import annotations

import torch
from torch import Tensor

_BITS = 20


def morton_order(means: Tensor) -> Tensor:
    """Index (N,) int64 that sorts points (N, 3) along a Morton (Z-order) curve; stable.

    The rasterizer works in any order, but is faster in this one: reorder a scene once after it was
    initialised or densified (`gaussians.select(morton_order(gaussians.means))`).
    """
    if len(means) == 0:
        return torch.zeros(0, dtype=torch.int64, device=means.device)
    points = means.detach().double()
    low = points.amin(dim=0)
    # One scale for all axes: cells must be cubes for the curve to keep neighbours together.
    size = (points.amax(dim=0) - low).max().clamp(min=1e-12)
    cells = ((points - low) / size * (2**_BITS - 1)).long()
    code = torch.zeros(len(means), dtype=torch.int64, device=means.device)
    for axis in range(3):
        code |= _spread(cells[:, axis]) << axis
    return code.argsort(stable=True)


def _spread(value: Tensor) -> Tensor:
    """Put two zero bits between the bits of values below 2^20."""
    value = (value | value << 32) & 0x1F00000000FFFF
    value = (value | value << 16) & 0x1F0000FF0000FF
    value = (value | value << 8) & 0x100F00F00F00F00F
    value = (value | value << 4) & 0x10C30C30C30C30C3
    return (value | value << 2) & 0x1249249249249249
