"""What nobody saw follows what was seen of the same paint.

A generator misses the paint's colour a little, and misses it everywhere alike. Where images have
corrected it, the correction is known; parts that no image shows take over that of parts which the
generator gave the same look.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from recast.actors.shares import Shares
from recast.splats import Gaussians
from recast.splats.rotations import quat_to_matrix
from recast.splats.sh import C0

Array = NDArray[np.float64]

_KNOWN = 0.6  # share of images in a Gaussian that may lend its correction
# Differences that count as one: display colour, share of "up" in the normal, metres of height and
# of place.
_LOOK, _UP, _HEIGHT, _PLACE = 0.08, 0.4, 0.5, 3.0
_LENDERS = 32
_DOUBT = 2.0  # lenders' worth of evidence for no correction


def follow_paint(prior: Gaussians, refined: Gaussians, shares: Shares) -> Gaussians:
    """The refined Gaussians, the invented ones with the correction of those that look alike.

    Args:
        prior: as the generator made them, row by row those of `refined`.
        refined: actor frame.
        shares: where each comes from; the invented share of the correction is taken over.
    """
    known = (shares.seen + shares.mirrored).numpy()
    lenders = np.flatnonzero(known > _KNOWN)
    if len(lenders) == 0:
        return refined
    features = _features(prior)
    change = (refined.sh[:, 0] - prior.sh[:, 0]).numpy().astype(np.float64)
    borrowers = np.flatnonzero(known < 1 - 1e-3)
    count = min(_LENDERS, len(lenders))
    distance, near = cKDTree(features[lenders]).query(features[borrowers], k=count)
    distance, near = distance.reshape(len(borrowers), -1), near.reshape(len(borrowers), -1)
    weight = np.exp(-0.5 * distance**2) * known[lenders][near]
    lent = np.einsum("nk,nkc->nc", weight, change[lenders][near])
    lent /= (weight.sum(axis=1) + _DOUBT)[:, None]
    sh = refined.sh.clone()
    share = shares.invented.numpy()[borrowers, None]
    sh[borrowers, 0] += torch.from_numpy(share * (lent - change[borrowers])).float()
    return replace(refined, sh=sh)


def _features(gaussians: Gaussians) -> Array:
    """(N, 8) look, normal, height and place, each over what counts as one."""
    axes = quat_to_matrix(gaussians.quats)
    thin = gaussians.log_scales.argmin(dim=1)
    up = axes[:, 2].gather(1, thin[:, None]).abs()
    look: Tensor = (0.5 + C0 * gaussians.sh[:, 0]).clamp(0, 1)
    parts = (
        look / _LOOK, up / _UP, gaussians.means[:, 2:] / _HEIGHT,
        gaussians.means[:, :2] * torch.tensor([1.0, 0.0]) / _PLACE,
    )  # fmt: skip
    return torch.cat(parts, dim=1).detach().numpy().astype(np.float64)
