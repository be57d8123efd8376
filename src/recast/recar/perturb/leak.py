"""A mask that spills over: the shadow under the vehicle, lumps of what stands behind it."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from recast.recar.perturb.backdrop import backdrop
from recast.recar.perturb.extent import ObjectBox, find_object
from recast.recar.perturb.kind import Kind, Picture, Positive, Share, Weight
from recast.recar.perturb.premultiplied import Floats, colour_and_alpha
from recast.recar.perturb.reveal import reveal
from recast.recar.perturb.signed_distance import signed_distance
from recast.recar.perturb.value_noise import value_noise


class Leak(Kind):
    """Background that counts as object.

    Attributes:
        radius: of a lump at severity 1, over the extent.
        shadow: chance that the vehicle's shadow leaks in too, as in many logs.
    """

    name: ClassVar[str] = "leak"

    weight: Weight = 0.2
    radius: Positive = 0.16
    shadow: Share = 0.6

    def __call__(self, rgba: Picture, severity: float, rng: np.random.Generator) -> Picture:
        """Spoil a picture; see `Perturbation`."""
        height, width = rgba.shape[:2]
        box = find_object(rgba)
        street = backdrop(rgba, box, rng)
        wobble = value_noise(height, width, 0.1 * box.extent, rng)
        _, alpha = colour_and_alpha(rgba)
        edge = np.argwhere(np.abs(signed_distance(alpha)) < 1)
        spilt = np.zeros_like(alpha)
        for _ in range(int(rng.integers(1, 4))):
            row, column = edge[rng.integers(len(edge))]
            radii = severity * self.radius * box.extent * rng.uniform(0.5, 1, 2)
            spilt = np.maximum(spilt, _lump(wobble, (row, column), radii))
        shaded = self._shadow(box, wobble, severity, rng)
        dark = rng.uniform(0.04, 0.12)
        behind = street + (np.float32(dark) - street) * shaded[..., None]
        return reveal(rgba, np.maximum(alpha, np.maximum(spilt, shaded)), behind)

    def _shadow(
        self, box: ObjectBox, wobble: Floats, severity: float, rng: np.random.Generator
    ) -> Floats:
        """A flat lump on the ground, as wide as the object."""
        cast = rng.uniform() < self.shadow
        centre = (box.bottom - 0.05 * box.extent, box.left + rng.uniform(0.4, 0.6) * box.width)
        flat = severity * rng.uniform(0.25, 0.5) * self.radius * box.extent
        lump = _lump(wobble, centre, np.array([flat, rng.uniform(0.32, 0.45) * box.width]))
        return lump if cast and flat > 0.5 else np.zeros_like(lump)


def _lump(
    wobble: Floats, centre: tuple[float, float], radii: np.ndarray[tuple[int], np.dtype[np.float64]]
) -> Floats:
    """Coverage of an uneven ellipse, by row and column in pixels."""
    height, width = wobble.shape
    radii = np.maximum(radii, 1e-3)
    rows = (np.arange(height, dtype=np.float32)[:, None] - centre[0]) / radii[0]
    columns = (np.arange(width, dtype=np.float32)[None, :] - centre[1]) / radii[1]
    beyond = np.sqrt(rows**2 + columns**2) * (1 + 0.12 * wobble) - 1
    return np.clip(0.5 - beyond * radii.min(), 0, 1).astype(np.float32)
