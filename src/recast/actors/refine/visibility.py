"""How much of a vehicle was seen, how much is mirrored, and how much is invented.

The weight that a Gaussian has in a picture is the sum over pixels of its transmittance times its
alpha. The rasterizer gives it as the derivative of the picture's sum by a constant colour, so that
occlusion, opacity and the vehicle's own parts in between are all in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from recast.actors.refine.layers import Layers
from recast.actors.shares import Shares
from recast.scene.mirror import mirrored
from recast.splats import Gaussians, LowPass, rasterize
from recast.splats.sh import C0

_ENOUGH = 6.0  # pixels of a Gaussian's own over all images that make it two thirds seen
_NEIGHBOURS = 8
_MIRRORED, _INVENTED = 0.6, 0.05  # freedom of such Gaussians where seen ones have 1


def freedom(gaussians: Gaussians, shares: Shares) -> Tensor:
    """(N,) in [0, 1] how far each Gaussian may leave the prior, smooth over its neighbours."""
    own = shares.seen + _MIRRORED * shares.mirrored + _INVENTED * shares.invented
    points = gaussians.means.detach().numpy()
    _, near = cKDTree(points).query(points, k=min(_NEIGHBOURS, len(points)))
    return 0.5 * own + 0.5 * own[torch.from_numpy(near.reshape(len(points), -1))].mean(dim=1)


def pixel_weights(
    gaussians: Gaussians, low_pass: LowPass, layers: Layers, pixels: Tensor
) -> Tensor:
    """(N,) sum over pixels of transmittance times alpha of each Gaussian, weighted by `pixels`.

    Args:
        gaussians: actor frame.
        pixels: (H, W) weights.
    """
    # One constant colour of its own a Gaussian, far from the clamp at zero.
    white = gaussians.sh.new_zeros(len(gaussians), 1, 3).requires_grad_()
    drawn = rasterize(
        replace(gaussians.detach(), sh=white), layers.camera_from_world @ layers.world_from_object,
        layers.K, layers.sighting.camera.width, layers.sighting.camera.height,
        eps2d=low_pass.variance, antialiased=low_pass.antialiased,
    )  # fmt: skip
    (drawn.rgb[..., 0] * pixels).sum().backward()
    assert white.grad is not None
    return white.grad[:, 0, 0].abs() / C0


def shares_of(
    gaussians: Gaussians, low_pass: LowPass, views: Sequence[Layers], symmetric: bool
) -> Shares:
    """Shares of Gaussians in the actor frame, by all images.

    Args:
        symmetric: whether the other side may teach.
    """
    everything = torch.ones(len(gaussians), dtype=torch.bool)
    other = mirrored(gaussians.detach(), everything)
    own, twin = torch.zeros(len(gaussians)), torch.zeros(len(gaussians))
    for view in views:
        pixels = view.sighting.weight * view.mask * view.trust * view.through
        own += pixel_weights(gaussians, low_pass, view, pixels)
        if symmetric:
            twin += pixel_weights(other, low_pass, view, pixels)
    seen = 1 - torch.exp(-own / _ENOUGH)
    return Shares(seen, (1 - seen) * (1 - torch.exp(-twin / _ENOUGH)))
