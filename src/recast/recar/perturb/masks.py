"""Faults of the mask: too small, too large, with holes, spilt over, in steps."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np

from recast.arrays import Image
from recast.geometry.colour import LUMINANCE, srgb_to_linear
from recast.recar.perturb.kind import (
    Floats,
    ObjectBox,
    PerturbationKind,
    Positive,
    Share,
    Weight,
    backdrop,
    colour_and_alpha,
    reveal,
    signed_distance,
    value_noise,
    with_alpha,
)

_LUMINANCE = np.array(LUMINANCE, np.float32)


class Erosion(PerturbationKind):
    """An edge that moves inwards, further in some places than in others; mirrors and tyres go.

    Attributes:
        depth: mean distance at severity 1, over the extent.
    """

    name: ClassVar[str] = "erosion"

    weight: Weight = 0.2
    depth: Positive = 0.025

    def _run(self, rgba: Image, box: ObjectBox, severity: float, rng: np.random.Generator) -> Image:
        height, width = rgba.shape[:2]
        extent = box.extent
        uneven = np.clip(1 + 0.6 * value_noise(height, width, 0.15 * extent, rng), 0, 3)
        colour, alpha = colour_and_alpha(rgba)
        inwards = severity * self.depth * extent * uneven
        # Ramp a pixel wide, that leaves soft edges alone where nothing is eroded.
        kept = np.clip(signed_distance(alpha) - inwards + 1.5, 0, 1)
        return with_alpha(colour, alpha * kept)


class Dilation(PerturbationKind):
    """An edge that moves outwards, further in some places than in others.

    Attributes:
        depth: mean distance at severity 1, over the extent.
    """

    name: ClassVar[str] = "dilation"

    weight: Weight = 0.2
    depth: Positive = 0.02

    def _run(self, rgba: Image, box: ObjectBox, severity: float, rng: np.random.Generator) -> Image:
        height, width = rgba.shape[:2]
        street = backdrop(rgba, box, rng)
        uneven = np.clip(1 + 0.6 * value_noise(height, width, 0.15 * box.extent, rng), 0, 3)
        _, alpha = colour_and_alpha(rgba)
        outwards = severity * self.depth * box.extent * uneven
        grown = np.clip(signed_distance(alpha) + outwards - 0.5, 0, 1)
        return reveal(rgba, np.maximum(alpha, grown), street)


class Holes(PerturbationKind):
    """Lumps that are missing, the dark parts (glass, tyres, arches) before the others.

    Attributes:
        share: share of the object's area that is missing at severity 1.
        darkness: weight of a pixel's darkness against that of chance.
    """

    name: ClassVar[str] = "holes"

    weight: Weight = 0.2
    share: Share = 0.22
    darkness: Share = 0.4

    def _run(self, rgba: Image, box: ObjectBox, severity: float, rng: np.random.Generator) -> Image:
        height, width = rgba.shape[:2]
        extent = box.extent
        lumps = value_noise(height, width, rng.uniform(0.12, 0.3) * extent, rng, octaves=2)
        colour, alpha = colour_and_alpha(rgba)
        inside = alpha > 0.5
        bright = srgb_to_linear(colour) @ _LUMINANCE
        order = np.searchsorted(np.sort(bright[inside]), bright) / max(int(inside.sum()), 1)
        # Smooth, or single dark pixels would make a sieve of it.
        rank = cv2.GaussianBlur(order.astype(np.float32), (0, 0), 0.02 * extent)
        field = (1 - self.darkness) * lumps + self.darkness * 3 * (rank - 0.5)
        lowest = np.quantile(field[inside], severity * self.share)
        # A ramp of about a pixel: lumps rise by one over a tenth of the extent.
        kept = np.clip((field - lowest) * 0.1 * extent + 1 - severity, 0, 1)
        return with_alpha(colour, (alpha * kept).astype(np.float32))


class Jagged(PerturbationKind):
    """Square steps along the edge; some of the object is lost and some background comes in.

    Attributes:
        cell: size of a cell of the grid at severity 1, over the extent.
    """

    name: ClassVar[str] = "jagged"

    weight: Weight = 0.2
    cell: Positive = 0.04

    def _run(self, rgba: Image, box: ObjectBox, severity: float, rng: np.random.Generator) -> Image:
        height, width = rgba.shape[:2]
        street = backdrop(rgba, box, rng)
        cell = severity * self.cell * box.extent
        if cell <= 1:
            return rgba.copy()
        _, alpha = colour_and_alpha(rgba)
        size = (max(round(width / cell), 1), max(round(height / cell), 1))
        small = cv2.resize(alpha, size, interpolation=cv2.INTER_AREA)
        steps = (small > rng.uniform(0.35, 0.65, small.shape)).astype(np.float32)
        mask = cv2.resize(steps, (width, height), interpolation=cv2.INTER_NEAREST)
        return reveal(rgba, np.asarray(mask, np.float32), street)


class Leak(PerturbationKind):
    """Background that counts as object.

    Attributes:
        radius: radius of a lump at severity 1, over the extent.
        shadow: chance that the vehicle's shadow leaks in too, as in many logs.
    """

    name: ClassVar[str] = "leak"

    weight: Weight = 0.2
    radius: Positive = 0.16
    shadow: Share = 0.6

    def _run(self, rgba: Image, box: ObjectBox, severity: float, rng: np.random.Generator) -> Image:
        height, width = rgba.shape[:2]
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
