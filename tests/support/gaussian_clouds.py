"""Gaussians in front of a camera at the origin."""

from __future__ import annotations

import numpy as np
import torch

from recast.splats import Gaussians
from recast.splats.gaussians import C0

K = torch.tensor([[40.0, 0.0, 24.0], [0.0, 40.0, 16.0], [0.0, 0.0, 1.0]])
"""Of an image of 48 x 32."""


def part(n: int, seed: int) -> Gaussians:
    """`n` Gaussians around (0, 0, 4) with view-dependent colour."""
    generator = torch.Generator().manual_seed(seed)

    def random(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    return Gaussians(
        means=random(n, 3) * 0.5 + torch.tensor([0.0, 0.0, 4.0]),
        quats=random(n, 4),
        log_scales=random(n, 3) * 0.3 - 2,
        logit_opacities=random(n),
        sh=random(n, 4, 3) * 0.3,
    )


def grey_gaussians(means: np.ndarray, sigma: float, colour: float = 0.5) -> Gaussians:
    """Round Gaussians of one grey."""
    n = len(means)
    return Gaussians(
        means=torch.from_numpy(means).float(),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(n, 1),
        log_scales=torch.full((n, 3), float(np.log(sigma))),
        logit_opacities=torch.full((n,), 3.0),
        sh=torch.full((n, 1, 3), (colour - 0.5) / C0),
    )
