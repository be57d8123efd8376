"""Masks that agree over time: what all images together say of the vehicle's outline.

Single masks err: a shadow, a neighbour, a window that shows the road behind. They err differently
in every image, but the vehicle is one body. Its visual hull is carved from all masks at once, and
each mask is believed where it agrees with the hull's outline.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.actors.evidence.sighting import Sighting
from recast.geometry import se3

Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]

_CELLS = 60  # along the length
_GROWTH = 0.08  # share of the box by which the grid is larger
_SOLID = 0.75  # share of the weight of the images that see a cell which must have it in their mask
_DOUBT = 51 / 255  # trust in a pixel about which mask and hull differ
LEAST_AGREEMENT = 0.5
"""Overlap (IoU) of a mask and the hull's outline below which the image is left out."""


@dataclass(frozen=True)
class VisualHull:
    """Cells that the masks agree on.

    Attributes:
        centres: (M, 3) of the solid cells, object frame, metres.
        edge: of a cell, metres.
    """

    centres: Array
    edge: float

    def outline(self, sighting: Sighting) -> Float32Array:
        """Its silhouette (H, W) in [0, 1] in an image."""
        height, width = sighting.mask.shape
        drawn = np.zeros((height, width), np.uint8)
        points = se3.apply(sighting.camera_from_object, self.centres)
        points = points[points[:, 2] > 0.1]
        if len(points):
            pixels, depth = sighting.camera.project(points)
            # Squares as wide as a cell seen along its diagonal leave no gaps between them.
            side = max(round(float(1.2 * self.edge * sighting.camera.fx / np.median(depth))), 1)
            u, v = np.floor(pixels).astype(int).T
            inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
            drawn[v[inside], u[inside]] = 1
            drawn = np.asarray(cv2.dilate(drawn, np.ones((side, side), np.uint8)), np.uint8)
        return drawn.astype(np.float32)


def carve(sightings: Sequence[Sighting], size: Array) -> VisualHull:
    """The cells of the box that most of the images which see them have in their masks."""
    half = size / 2 * (1 + _GROWTH)
    edge = float(2 * half[0] / _CELLS)
    axes = [np.arange(-h + edge / 2, h, edge) for h in half]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    total, inside = np.zeros(len(centres)), np.zeros(len(centres))
    for sighting in sightings:
        height, width = sighting.mask.shape
        points = se3.apply(sighting.camera_from_object, centres)
        pixels, depth = sighting.camera.project(points)
        u, v = np.floor(pixels).astype(int).T
        seen = (u >= 0) & (u < width) & (v >= 0) & (v < height) & (depth > 0.1)
        weight = sighting.weight * sighting.trust[v[seen], u[seen]]
        total[seen] += weight
        inside[seen] += weight * sighting.mask[v[seen], u[seen]]
    solid = (total > 0) & (inside > _SOLID * total)
    return VisualHull(centres[solid], edge)


def settle_masks(
    sightings: Sequence[Sighting], size: Array
) -> tuple[list[Sighting], list[Sighting]]:
    """The sightings with their trust lowered where mask and visual hull differ.

    Args:
        size: (3,) of the box, metres.

    Returns:
        those that agree with the others, and those that do not: their masks overlap with the
        hull's outline by less than half.
    """
    hull = carve(sightings, size)
    kept, refused = [], []
    for sighting in sightings:
        outline = hull.outline(sighting)
        mask = sighting.mask > 0.5
        seen = sighting.trust > 0
        union = float(((outline > 0) | mask)[seen].sum())
        both = float(((outline > 0) & mask)[seen].sum())
        agreement = both / union if union else 0.0
        if agreement < LEAST_AGREEMENT:
            refused.append(sighting)
            continue
        differs = (outline > 0.5) != mask
        trust = sighting.trust * np.where(differs, np.float32(_DOUBT), np.float32(1))
        kept.append(replace(sighting, trust=trust.astype(np.float32)))
    return kept, refused
