"""Vehicles are symmetric: the flip prior of Street Gaussians.

A reflection at the plane between left and right, y -> -y in the box frame, carries a Gaussian to
where an equal one is expected on the side that no camera sees.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import torch
from torch import Tensor

from recast.logs import Track
from recast.splats import Gaussians, concatenate

DEFORMABLE = frozenset({"pedestrian"})
"""Categories that are not symmetric at every moment."""
ARTICULATED = frozenset({"pedestrian", "cyclist"})
"""Categories that have limbs: what deformable nodes are for."""


def mirrored(gaussians: Gaussians, chosen: Tensor) -> Gaussians:
    """Reflect the rows of a (N,) bool mask at the plane y = 0; differentiable.

    A reflection is no rotation, but diag(-1, 1, -1), the half turn about y, makes the same
    covariance of every Gaussian as diag(1, -1, 1). View-dependent colour is reflected too: of the
    real harmonics those of negative order are odd in y.
    """
    sign = torch.where(chosen, -1.0, 1.0).to(gaussians.means)
    one = torch.ones_like(sign)
    w, x, y, z = gaussians.quats.unbind(-1)
    turned = torch.stack([-y, z, w, -x], dim=-1)  # (0, 0, 1, 0) times the quaternion
    return replace(
        gaussians,
        means=gaussians.means * torch.stack([one, sign, one], dim=-1),
        quats=torch.where(chosen[:, None], turned, gaussians.quats),
        sh=torch.where(chosen[:, None, None], gaussians.sh * _parity(gaussians), gaussians.sh),
    )


def with_other_side(gaussians: Gaussians) -> Gaussians:
    """The side with more Gaussians, and its reflection beside all that was there."""
    left = gaussians.means[:, 1] > 0
    side = left if int(left.sum()) * 2 >= len(left) else ~left
    fuller = gaussians.select(side)
    everywhere = torch.ones(len(fuller), dtype=torch.bool, device=side.device)
    return concatenate([gaussians, mirrored(fuller, everywhere)])


def _parity(gaussians: Gaussians) -> Tensor:
    """(K, 1) factors of the harmonics under y -> -y: -1 for orders below zero."""
    degrees = range(gaussians.sh_degree + 1)
    orders = [order for degree in degrees for order in range(-degree, degree + 1)]
    return torch.tensor([-1.0 if order < 0 else 1.0 for order in orders]).to(gaussians.sh)[:, None]


def symmetric_tracks(tracks: Iterable[Track]) -> Tensor:
    """(T,) bool: tracks whose category is symmetric at every moment."""
    return torch.tensor([track.category not in DEFORMABLE for track in tracks], dtype=torch.bool)
