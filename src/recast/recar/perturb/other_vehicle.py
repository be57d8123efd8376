"""Occlusion by another vehicle that stands nearer."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np

from recast.recar.perturb.extent import find_object
from recast.recar.perturb.kind import Kind, Picture, Positives, Share, Weight
from recast.recar.perturb.occlude import occlude
from recast.recar.perturb.premultiplied import Floats

# Outlines from the side, front to the right: x from the front backwards and y from the ground up,
# both over the vehicle's height. Wheels at x and of the radius that follow.
_OUTLINES: tuple[tuple[tuple[tuple[float, float], ...], tuple[float, ...]], ...] = (
    (  # sedan
        ((0, 0.2), (0, 0.5), (-0.9, 0.64), (-1.35, 0.97), (-1.6, 1.0), (-2.2, 0.97), (-2.7, 0.68),
         (-3.1, 0.64), (-3.1, 0.2)),
        (-0.6, -2.5, 0.23),
    ),
    (  # sport utility
        ((0, 0.2), (0, 0.55), (-0.75, 0.64), (-1.1, 0.98), (-2.5, 1.0), (-2.65, 0.62),
         (-2.65, 0.2)),
        (-0.5, -2.1, 0.22),
    ),
    (  # van
        ((0, 0.16), (0, 0.45), (-0.3, 0.55), (-0.6, 0.98), (-2.5, 1.0), (-2.55, 0.16)),
        (-0.45, -2.0, 0.17),
    ),
    (  # lorry
        ((0, 0.16), (0, 0.7), (-0.35, 0.74), (-0.36, 1.0), (-2.5, 1.0), (-2.5, 0.16)),
        (-0.35, -2.0, 0.14),
    ),
    (  # anything from behind
        ((0, 0.12), (0, 0.5), (-0.12, 0.9), (-0.25, 1.0), (-0.85, 1.0), (-0.98, 0.9),
         (-1.1, 0.5), (-1.1, 0.12)),
        (-0.12, -0.98, 0.12),
    ),
)  # fmt: skip
_PAINTS = np.array(
    [(0.75, 0.75, 0.76), (0.1, 0.1, 0.11), (0.4, 0.41, 0.43), (0.35, 0.08, 0.07), (0.1, 0.16, 0.3)],
    np.float32,
)
_SHIFT = 4  # fractional bits of OpenCV's coordinates


def _silhouette(
    height: int, width: int, outline: int, front: tuple[float, float], tall: float, mirrored: bool
) -> Floats:
    """Coverage (height, width) of a vehicle whose front touches the ground at `front`."""
    corners, (first, second, radius) = _OUTLINES[outline]
    towards = -tall if mirrored else tall
    canvas = np.zeros((height, width), np.uint8)
    points = np.array(corners) * (towards, -tall) + front
    whole = np.round(points * 2**_SHIFT).astype(np.int32)
    cv2.fillPoly(canvas, [whole], 255, cv2.LINE_AA, _SHIFT)
    for x in (first, second):
        centre = (front[0] + towards * x, front[1] - tall * radius)
        place = tuple(round(value * 2**_SHIFT) for value in centre)
        cv2.circle(canvas, place, round(tall * radius * 2**_SHIFT), 255, -1, cv2.LINE_AA, _SHIFT)
    return canvas.astype(np.float32) / 255


class OtherVehicle(Kind):
    """The silhouette of a vehicle that comes in from the left or the right.

    Attributes:
        cover: share of the object's width that it has passed at severity 1.
        height: lowest and highest occluder over the object's height, drawn uniformly.
        fringe: widest edge that the mask keeps, over the extent.
    """

    name: ClassVar[str] = "other-vehicle"

    weight: Weight = 1 / 3
    cover: Share = 0.5
    height: Positives = (0.8, 1.7)
    fringe: Share = 0.012

    def __call__(self, rgba: Picture, severity: float, rng: np.random.Generator) -> Picture:
        """Spoil a picture; see `Perturbation`."""
        rows, columns = rgba.shape[:2]
        box = find_object(rgba)
        from_left = bool(rng.integers(2))
        outline = int(rng.integers(len(_OUTLINES)))
        tall = rng.uniform(*self.height) * box.height
        # The nearer vehicle meets the ground lower in the picture.
        ground = box.bottom + rng.uniform(0.02, 0.3) * tall
        paint = _PAINTS[rng.integers(len(_PAINTS))]
        fringe = rng.uniform(0, self.fringe) * box.extent
        # At severity 0 its antialiased edge stays outside too.
        passed = severity * self.cover * box.width - 1.5 * (1 - severity)
        front = box.left + passed if from_left else box.right - passed
        coverage = _silhouette(rows, columns, outline, (front, ground), tall, not from_left)
        return occlude(rgba, coverage, paint, fringe)
