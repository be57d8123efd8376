"""How much of a vehicle was seen, mirrored or invented, and the paint of what nobody saw.

The weight that a Gaussian has in a picture is the sum over pixels of its transmittance times its
alpha. The rasterizer gives it as the derivative of the picture's sum by a constant colour, so that
occlusion, opacity and the vehicle's own parts in between are all in it.

A generator misses the paint's colour a little, and misses it everywhere alike. Where images have
corrected it, the correction is known; parts that no image shows take over that of parts which the
generator gave the same look.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from recast.actors.coverage import Shares
from recast.actors.refine.surroundings import Layers
from recast.arrays import Array
from recast.scene.actor import draw
from recast.scene.appearance import mirrored
from recast.splats import Gaussians, LowPass
from recast.splats.gaussians import quat_to_matrix
from recast.splats.sh import C0

_PATCH = 0.06  # metres around a Gaussian that are seen or not seen together
_PATCH_PX = 1.5  # pixels of the nearest image that a patch is at least: less cannot be told apart
_SHOWN = 0.5  # pixels of a Gaussian's own over all images that put it in the picture
_SEEN = 20.0  # pixels of a patch over all images that make it two thirds seen
_NEIGHBOURS = 8
_MIRRORED = 0.6  # of the freedom, for what only the other side's images show

_KNOWN = 0.6  # share of images in a Gaussian that may lend its correction
# Differences that count as one: display colour, share of "up" in the normal, metres of height and
# of place.
_LOOK, _UP, _HEIGHT, _PLACE = 0.08, 0.4, 0.5, 3.0
_LENDERS = 32
_DOUBT = 2.0  # lenders' worth of evidence for no correction


@dataclass(frozen=True)
class Visibility:
    """What images show of N Gaussians, in pixels of the patch of surface around each.

    Attributes:
        own: (N,) float32 sum over all images, weighted as they are.
        twin: (N,) the same sum of the mirrored vehicle.
        shown: (N,) bool, which Gaussians themselves are in a picture, or mirrored in one.
    """

    own: Tensor
    twin: Tensor
    shown: Tensor

    @property
    def shares(self) -> Shares:
        """Where each comes from."""
        seen = 1 - torch.exp(-self.own / _SEEN)
        return Shares(seen, (1 - seen) * (1 - torch.exp(-self.twin / _SEEN)))

    def freedom(self, gaussians: Gaussians) -> Tensor:
        """(N,) in [0, 1] how far each of `gaussians` may leave the prior, smoothly over them."""
        shares = self.shares
        own = shares.seen + _MIRRORED * shares.mirrored
        points = gaussians.means.detach().numpy()
        _, near = cKDTree(points).query(points, k=min(_NEIGHBOURS, len(points)))
        around = own[torch.from_numpy(near.reshape(len(points), -1))].mean(dim=1)
        return 0.5 * (own + around)

    def select(self, index: Tensor) -> Visibility:
        """That of the Gaussians at `index`."""
        return Visibility(self.own[index], self.twin[index], self.shown[index])


def pixel_weights(
    gaussians: Gaussians, low_pass: LowPass, layers: Layers, pixels: Tensor
) -> Tensor:
    """(N,) sum over pixels of transmittance times alpha of each Gaussian, weighted by `pixels`.

    Args:
        gaussians: Gaussians in the actor frame.
        pixels: (H, W) weights.
    """
    # One constant colour of its own a Gaussian, far from the clamp at zero.
    white = gaussians.sh.new_zeros(len(gaussians), 1, 3).requires_grad_()
    pose = layers.camera_from_world @ layers.world_from_object
    drawn = draw(replace(gaussians.detach(), sh=white), pose, layers.sighting.camera, low_pass)
    (drawn.rgb[..., 0] * pixels).sum().backward()
    assert white.grad is not None
    return white.grad[:, 0, 0].abs() / C0


def visibility_of(
    gaussians: Gaussians, low_pass: LowPass, views: Sequence[Layers], symmetric: bool
) -> Visibility:
    """What all images show of Gaussians in the actor frame.

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
    reach = max(_PATCH, _PATCH_PX * min((_metres_a_pixel(view) for view in views), default=0.0))
    patches = _Patches(gaussians.means.detach().numpy(), reach)
    return Visibility(patches.sum(own), patches.sum(twin), (own + twin) > _SHOWN)


class _Patches:
    """Sums over all points within `reach` of each of points (N, 3), up to half a `reach`.

    Points are gathered in cells half as wide: the number of pairs does not grow with `reach`.
    """

    def __init__(self, points: NDArray[np.float32], reach: float) -> None:
        places = np.floor(points / (reach / 2)).astype(np.int64)
        _, found, count = np.unique(places, axis=0, return_inverse=True, return_counts=True)
        cell = found.reshape(-1)
        centres = np.stack([np.bincount(cell, one) for one in points.T], axis=-1) / count[:, None]
        tree = cKDTree(centres)
        pairs = tree.sparse_distance_matrix(tree, reach, output_type="coo_matrix")
        self._cell, self._cells = torch.from_numpy(cell), len(centres)
        self._rows = torch.from_numpy(pairs.row.astype(np.int64))
        self._columns = torch.from_numpy(pairs.col.astype(np.int64))

    def sum(self, pixels: Tensor) -> Tensor:
        """Sums (N,) of `pixels` (N,) around each point."""
        own = pixels.new_zeros(self._cells).index_add(0, self._cell, pixels)
        around = torch.zeros_like(own).index_add(0, self._rows, own[self._columns])
        return around[self._cell]


def _metres_a_pixel(view: Layers) -> float:
    """Size of a pixel at the vehicle's middle, metres."""
    depth = (view.camera_from_world @ view.world_from_object)[2, 3]
    return float(depth / view.sighting.camera.fx)


def follow_paint(prior: Gaussians, refined: Gaussians, shares: Shares) -> Gaussians:
    """The refined Gaussians, the invented ones with the correction of those that look alike.

    Args:
        prior: Gaussians as the generator made them, row by row those of `refined`.
        refined: refined Gaussians, actor frame.
        shares: shares that tell where each Gaussian comes from; the invented share of the
            correction is taken over.
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
        look / _LOOK,
        up / _UP,
        gaussians.means[:, 2:] / _HEIGHT,
        gaussians.means[:, :2] * torch.tensor([1.0, 0.0]) / _PLACE,
    )
    return torch.cat(parts, dim=1).detach().numpy().astype(np.float64)
