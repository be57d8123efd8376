"""A body's clothes: colours that explain the images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from recast.actors.actor import Shares
from recast.actors.people.body import BodySurface, Region
from recast.actors.people.views import PersonView
from recast.arrays import Array
from recast.splats import Gaussians
from recast.splats.gaussians import C0

_DISPLAY = {
    Region.SKIN: (0.66, 0.50, 0.42),
    Region.HAIR: (0.20, 0.16, 0.13),
    Region.TOP: (0.35, 0.36, 0.40),
    Region.TROUSERS: (0.22, 0.23, 0.28),
    Region.SHOES: (0.20, 0.19, 0.19),
    Region.PACK: (0.25, 0.25, 0.27),
    Region.FRAME: (0.25, 0.26, 0.28),
    Region.TYRE: (0.08, 0.08, 0.08),
    Region.METAL: (0.45, 0.45, 0.46),
}
"""Display colours of what no image shows."""
_NEIGHBOURS = 5
_SMOOTH, _ALIKE = 3.0, 1.0  # weights of neighbours and of the other side beside the images
_REGION_STEPS, _PATCH_STEPS = 60, 200
DRESS_STEPS = _REGION_STEPS + _PATCH_STEPS
"""Steps of the descent over colours."""
_UNCLEAR = 0.1  # weight of a pixel that looks like the street
_SEEN_PX = 0.7  # summed over the images, from which on a patch counts as seen


@dataclass(frozen=True)
class Clothes:
    """Display colours (N, 3) of a body's patches, and where they come from."""

    colours: Array
    shares: Shares


def region_colours(
    surface: BodySurface, posed: Sequence[Gaussians], views: Sequence[PersonView]
) -> Tensor:
    """(R, 3) one display colour for each `Region`.

    Args:
        posed: the body in each view, in the view's box frame.
    """
    region = torch.from_numpy(surface.region)
    plain = torch.tensor([_DISPLAY[one] for one in Region]).requires_grad_()
    _descend(plain, 0.03, _REGION_STEPS, len(views), _losses(posed, views, lambda: plain[region]))
    return plain.detach()


def dress(surface: BodySurface, posed: Sequence[Gaussians], views: Sequence[PersonView]) -> Clothes:
    """Colours of whole regions first, then of patches.

    A patch that no image shows gets what its neighbours of the same region and its twin on the
    other side of the body have.

    Args:
        posed: see `region_colours`.
    """
    plain = region_colours(surface, posed, views)
    colours = plain[torch.from_numpy(surface.region)].requires_grad_()
    edges, twin = _edges(surface), torch.from_numpy(surface.twin)
    shown = _losses(posed, views, lambda: colours)

    def loss(number: int) -> Tensor:
        rough = (colours[edges[:, 0]] - colours[edges[:, 1]]).square().sum(dim=1)
        apart = (colours - colours[twin]).square().sum(dim=1)
        return shown(number) + _SMOOTH * rough.mean() + _ALIKE * apart.mean()

    _descend(colours, 0.02, _PATCH_STEPS, len(views), loss)
    seen = _seen(posed, views)
    shares = Shares(seen, (1 - seen) * seen[twin])
    return Clothes(colours.detach().double().numpy(), shares)


def _known(view: PersonView) -> Tensor:
    """(H, W, 1) how much each pixel tells of the person's colours."""
    clear = np.float32(_UNCLEAR) + np.float32(1 - _UNCLEAR) * view.apart
    return torch.from_numpy(view.trust * view.mask * clear * np.float32(view.weight))[..., None]


def _losses(
    posed: Sequence[Gaussians], views: Sequence[PersonView], colours: Callable[[], Tensor]
) -> Callable[[int], Tensor]:
    """Mean difference from the image of a view, by its number, of a body in colours (N, 3)."""
    known = [_known(view) for view in views]

    def loss(number: int) -> Tensor:
        view, usable = views[number], known[number]
        sh = (colours()[:, None] - 0.5) / C0
        picture, _ = view.drawn(replace(posed[number], sh=sh))
        return ((picture - view.image).abs() * usable).sum() / usable.sum().clamp(min=1.0)

    return loss


def _descend(
    values: Tensor, rate: float, steps: int, views: int, loss: Callable[[int], Tensor]
) -> None:
    """Adam over the views in turn, its rate falling to a tenth."""
    optimizer = torch.optim.Adam([values], lr=rate)
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = rate * 0.1 ** (step / steps)
        optimizer.zero_grad()
        loss(step % views).backward()
        optimizer.step()
        with torch.no_grad():
            values.clamp_(0, 1)


def _seen(posed: Sequence[Gaussians], views: Sequence[PersonView]) -> Tensor:
    """(N,) in [0, 1] how well the images show each patch."""
    total = torch.zeros(len(posed[0]))
    for gaussians, view in zip(posed, views, strict=True):
        light = torch.ones(len(gaussians), 3, requires_grad=True)
        picture, _ = view.drawn(replace(gaussians, sh=(light[:, None] - 0.5) / C0))
        (picture * _known(view)).sum().backward()
        assert light.grad is not None
        total += light.grad.mean(dim=1)
    return (total / _SEEN_PX).clamp(0, 1)


def _edges(surface: BodySurface) -> Tensor:
    """(E, 2) neighbours of one region."""
    near = cKDTree(surface.points).query(surface.points, k=_NEIGHBOURS + 1)[1][:, 1:]
    pairs = np.stack([np.repeat(np.arange(len(near)), _NEIGHBOURS), near.ravel()], axis=-1)
    same = surface.region[pairs[:, 0]] == surface.region[pairs[:, 1]]
    return torch.from_numpy(pairs[same])
