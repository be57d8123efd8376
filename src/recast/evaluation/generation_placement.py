"""How a generated vehicle comes to stand in its box when models are compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, Literal, get_args

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from recast.actors import Asset, Observation
from recast.actors.hull import Surface, bounds
from recast.actors.place import place_asset
from recast.actors.start import stood_up
from recast.geometry import se3
from recast.splats import Gaussians

Array = NDArray[np.float64]

Placement = Literal["views", "canonical"]
"""`views`: by the conditioning view, as `recast eval actor`; `canonical`: as the model says."""
PLACEMENTS: tuple[Placement, ...] = get_args(Placement)


def place(
    asset: Asset, size: ArrayLike, observations: Sequence[Observation], how: Placement
) -> tuple[Gaussians, dict[str, Any]]:
    """Gaussians in the actor frame, and plain facts on how they were placed.

    Args:
        asset: from an `ActorGenerator`.
        size: (3,) length, width, height of the box, metres.
        observations: conditioning views with cameras; only `views` looks at them.
        how: see `Placement`.

    Raises:
        InputError: see `stood_up`.
    """
    if how == "views":
        placed = place_asset(asset, size, observations)
        return placed.gaussians, {"by": how, **asdict(placed.report)}
    return place_canonical(asset, size)


def place_canonical(asset: Asset, size: ArrayLike) -> tuple[Gaussians, dict[str, Any]]:
    """Believe the forward axis of the asset's convention; nothing is searched.

    Scaled so that its length is the box's, centred, and stood on the box's floor. It ends where
    its outermost Gaussians cover half, which is where masks end. For models that were trained to
    look along +x whatever they are shown: errors of a search do not blur the comparison then.

    Raises:
        InputError: see `stood_up`.
    """
    size = np.asarray(size, np.float64)
    gaussians, surface = stood_up(asset)
    low, high = _outline(gaussians, surface)
    scale = float(size[0] / (high[0] - low[0]))
    middle = (low + high) / 2 * scale
    shift = np.array([-middle[0], -middle[1], -size[2] / 2 - low[2] * scale])
    extent = (high - low) * scale
    facts = {
        "by": "canonical",
        "axes": asset.axes.name,
        "scale": scale,
        "width_over_box": float(extent[1] / size[1]),
        "height_over_box": float(extent[2] / size[2]),
    }
    matrix = se3.from_rotation_translation(np.eye(3), shift)
    return gaussians.transformed(torch.from_numpy(matrix), scale), facts


def _outline(gaussians: Gaussians, surface: Surface) -> tuple[Array, Array]:
    """Lower and upper corner (3,) of where outer Gaussians alone cover half; strays left out.

    A Gaussian of opacity o covers half at sqrt(2 ln(o / 0.5)) deviations.
    """
    chosen = gaussians.select(torch.from_numpy(surface.index))
    opacity = torch.sigmoid(chosen.logit_opacities).double().numpy()
    radius = np.sqrt(2 * np.log(np.maximum(opacity / 0.5, 1.0)))
    axes = se3.quat_to_matrix(chosen.quats.double().numpy())
    deviations = np.exp(chosen.log_scales.double().numpy())
    along = np.sqrt(np.einsum("nij,nj->ni", axes**2, deviations**2))
    reach = radius[:, None] * along
    return bounds(surface.points - reach)[0], bounds(surface.points + reach)[1]
