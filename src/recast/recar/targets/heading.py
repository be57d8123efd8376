"""Where a target looks: found by its pictures, since published models turn vehicles any way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from recast.recar.picture import Image
from recast.recar.targets.render import Cutout, closeness, framed, iou, of_picture, render
from recast.recar.targets.views import Viewpoint
from recast.splats import Gaussians

STEPS = 24
"""Headings that are tried around the circle, 15 degrees apart."""

WITHIN_DEG = 1.0
"""Largest last step: the best of them is then moved by ever smaller ones."""

_PIXELS = 64  # side of the cut-outs that are compared


def find_heading(
    gaussians: Gaussians, pictures: Sequence[Image], viewpoints: Sequence[Viewpoint]
) -> float:
    """Degrees in [0, 360) about z, from +x, to which the vehicle's front points.

    The heading under which renders agree best with all pictures, in outline and in colours. Both
    are cut out at one scale, so that size and place of the asset do not matter. Where a vehicle
    looks alike from several sides, such as front and rear, any of them may come out; its agreement
    is then alike too.

    Args:
        gaussians: the target, in the unit cube, z up.
        pictures: the vehicle, RGBA with straight alpha.
        viewpoints: where the pictures were taken from, azimuth 0 ahead of the vehicle.
    """
    wanted = [framed(of_picture(picture), _PIXELS) for picture in pictures]

    @cache  # views a quarter apart see the same pictures, one after the other
    def shown(viewpoint: Viewpoint) -> Cutout:
        return framed(render(gaussians, viewpoint, 2 * _PIXELS), _PIXELS)

    def agreement(heading: float) -> float:
        seen = [shown(turned(view, heading)) for view in viewpoints]
        return float(np.mean([iou(a.mask, b.mask) + closeness(a, b)
                              for a, b in zip(wanted, seen, strict=True)]))  # fmt: skip

    step = 360.0 / STEPS
    best = max((step * index for index in range(STEPS)), key=agreement)
    while step > WITHIN_DEG:
        step /= 2
        best = max((best, best - step, best + step), key=agreement)
    return best % 360.0


def turned(viewpoint: Viewpoint, heading_deg: float) -> Viewpoint:
    """The viewpoint in the frame of an asset whose front points to `heading_deg`."""
    return replace(viewpoint, azimuth_deg=(viewpoint.azimuth_deg + heading_deg) % 360.0)
