"""How a generated vehicle comes to stand in its box when models are compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, Literal, get_args

import numpy as np
import torch
from numpy.typing import ArrayLike

from recast.actors import Asset, Observation
from recast.actors.hull import bounds, outer_surface
from recast.actors.place import place_asset
from recast.actors.start import stand_on_box
from recast.errors import InputError
from recast.geometry import se3
from recast.splats import Gaussians

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
        InputError: the asset is hardly opaque.
    """
    if how == "views":
        placed = place_asset(asset, size, observations)
        return placed.gaussians, {"by": how, **asdict(placed.report)}
    return place_canonical(asset, size)


def place_canonical(asset: Asset, size: ArrayLike) -> tuple[Gaussians, dict[str, Any]]:
    """Believe the forward axis of the asset's convention; nothing is searched.

    Scaled by the length of its outer surface to the box's, centred, and stood on the box's floor.
    For models that were trained to look along +x whatever they are shown: errors of a search do
    not blur the comparison then.

    Raises:
        InputError: the asset is hardly opaque.
    """
    size = np.asarray(size, np.float64)
    upright = se3.from_rotation_translation(asset.axes.rotation(), np.zeros(3))
    gaussians = asset.gaussians.detach().transformed(torch.from_numpy(upright))
    try:
        points = outer_surface(gaussians).points
    except ValueError as error:
        raise InputError(
            f"asset of {asset.generator}", "opacity", str(error),
            "generate again with another seed, or export the asset again",
        ) from None  # fmt: skip
    start = stand_on_box(points, 0.0, size)
    extent = np.subtract(*bounds(points)[::-1]) * start.scale
    facts = {
        "by": "canonical",
        "axes": asset.axes.name,
        "scale": start.scale,
        "width_over_box": float(extent[1] / size[1]),
        "height_over_box": float(extent[2] / size[2]),
    }
    return gaussians.transformed(torch.from_numpy(start.matrix), start.scale), facts
