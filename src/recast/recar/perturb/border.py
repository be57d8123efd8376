"""Occlusion from one side: hedges, barriers, walls, the own bonnet."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from recast.recar.perturb.extent import find_object
from recast.recar.perturb.kind import Kind, Picture, Share, Weight
from recast.recar.perturb.occlude import occlude
from recast.recar.perturb.value_noise import value_noise

_COLOURS = np.array(
    [(0.16, 0.2, 0.12), (0.5, 0.49, 0.46), (0.3, 0.28, 0.26), (0.08, 0.08, 0.09)], np.float32
)
_SIDES = ("bottom", "left", "right", "top")
_CHANCES = (0.6, 0.17, 0.17, 0.06)


class Border(Kind):
    """Something with a straight or a ragged edge that comes in from a side, mostly from below.

    Attributes:
        cover: share of the object's height or width behind it at severity 1.
        ragged: highest standard deviation of its edge, over the extent.
        fringe: widest edge that the mask keeps, over the extent.
    """

    name: ClassVar[str] = "border"

    weight: Weight = 1 / 3
    cover: Share = 0.45
    ragged: Share = 0.02
    fringe: Share = 0.012

    def __call__(self, rgba: Picture, severity: float, rng: np.random.Generator) -> Picture:
        """Spoil a picture; see `Perturbation`."""
        height, width = rgba.shape[:2]
        box = find_object(rgba)
        side = _SIDES[int(rng.choice(len(_SIDES), p=_CHANCES))]
        slope = 0.06 * rng.standard_normal()
        rough = rng.uniform(0, self.ragged) * box.extent
        colour = _COLOURS[rng.integers(len(_COLOURS))]
        fringe = rng.uniform(0, self.fringe) * box.extent
        upright = side in ("bottom", "top")
        length = width if upright else height
        edge = rough * value_noise(1, length, 0.12 * box.extent, rng, octaves=4)[0]
        middle = box.left + box.width / 2 if upright else box.top + box.height / 2
        edge += slope * (np.arange(length) - middle)
        reach = severity * self.cover * (box.height if upright else box.width)
        # At severity 0 even the highest point of a ragged edge stays outside.
        reach -= (1 - severity) * max(float(edge.max()), 0.0)
        from_edge = {
            "bottom": box.bottom - np.arange(height)[:, None],
            "top": np.arange(height)[:, None] + 1 - box.top,
            "left": np.arange(width)[None, :] + 1 - box.left,
            "right": box.right - np.arange(width)[None, :],
        }[side]
        along = edge[None, :] if upright else edge[:, None]
        coverage = np.clip(reach + along - from_edge + 1, 0, 1).astype(np.float32)
        return occlude(rgba, coverage, colour, fringe)
