"""Faults of the outline: what hides a part of the object, and masks that miss or spill over."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np

from recast.arrays import Image
from recast.geometry.colour import LUMINANCE, srgb_to_linear
from recast.recar.perturb_camera import (
    Floats,
    ObjectBox,
    PerturbationKind,
    Positive,
    Positives,
    Share,
    Weight,
    backdrop,
    colour_and_alpha,
    reveal,
    signed_distance,
    value_noise,
    with_alpha,
)

_BORDER_COLOURS = np.array(
    [(0.16, 0.2, 0.12), (0.5, 0.49, 0.46), (0.3, 0.28, 0.26), (0.08, 0.08, 0.09)], np.float32
)
_BORDER_SIDES = ("bottom", "left", "right", "top")
_BORDER_CHANCES = (0.6, 0.17, 0.17, 0.06)
_POLE_COLOURS = np.array(
    [(0.45, 0.46, 0.47), (0.2, 0.21, 0.2), (0.33, 0.26, 0.2), (0.65, 0.65, 0.62)], np.float32
)
# Outlines from the side, front to the right: x from the front backwards and y from the ground up,
# both over the vehicle's height. Wheels at x and of the radius that follow.
_OUTLINES: tuple[tuple[tuple[tuple[float, float], ...], tuple[float, ...]], ...] = (
    (  # sedan
        (
            (0, 0.2),
            (0, 0.5),
            (-0.9, 0.64),
            (-1.35, 0.97),
            (-1.6, 1.0),
            (-2.2, 0.97),
            (-2.7, 0.68),
            (-3.1, 0.64),
            (-3.1, 0.2),
        ),
        (-0.6, -2.5, 0.23),
    ),
    (  # sport utility
        (
            (0, 0.2),
            (0, 0.55),
            (-0.75, 0.64),
            (-1.1, 0.98),
            (-2.5, 1.0),
            (-2.65, 0.62),
            (-2.65, 0.2),
        ),
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
        (
            (0, 0.12),
            (0, 0.5),
            (-0.12, 0.9),
            (-0.25, 1.0),
            (-0.85, 1.0),
            (-0.98, 0.9),
            (-1.1, 0.5),
            (-1.1, 0.12),
        ),
        (-0.12, -0.98, 0.12),
    ),
)
_PAINTS = np.array(
    [(0.75, 0.75, 0.76), (0.1, 0.1, 0.11), (0.4, 0.41, 0.43), (0.35, 0.08, 0.07), (0.1, 0.16, 0.3)],
    np.float32,
)
_SHIFT = 4  # fractional bits of OpenCV's coordinates
_CUT_SIDES = ("left", "right", "bottom", "top")
_CUT_CHANCES = (0.4, 0.4, 0.15, 0.05)


def occlude(rgba: Image, coverage: Floats, colour: Floats, fringe: float) -> Image:
    """Put an occluder before the object, which the segmenter leaves out but for a fringe.

    An occluder narrower than two fringes stays in the mask whole, as thin poles do.

    Args:
        coverage: (H, W) coverage by the occluder, in [0, 1].
        colour: (3,) colour of the occluder, sRGB in [0, 1].
        fringe: width of the occluder's edge that is taken for the object, pixels.
    """
    before, alpha = colour_and_alpha(rgba)
    solid = (coverage > 0.5).astype(np.uint8)
    depth = cv2.distanceTransform(solid, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    removed = coverage * np.clip(depth - fringe + 0.5, 0, 1)
    # Antialiased pixels just outside the solid part are removed with it, or stay with its fringe.
    if fringe < 0.5:
        removed = np.where(solid > 0, removed, coverage)
    seen = before + (colour - before) * coverage[..., None]
    return with_alpha(seen, alpha * (1 - removed))


class Border(PerturbationKind):
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

    def _run(self, rgba: Image, box: ObjectBox, severity: float, rng: np.random.Generator) -> Image:
        height, width = rgba.shape[:2]
        side = _BORDER_SIDES[int(rng.choice(len(_BORDER_SIDES), p=_BORDER_CHANCES))]
        slope = 0.06 * rng.standard_normal()
        rough = rng.uniform(0, self.ragged) * box.extent
        colour = _BORDER_COLOURS[rng.integers(len(_BORDER_COLOURS))]
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


class Pole(PerturbationKind):
    """An upright band from top to bottom, somewhere across the object.

    Attributes:
        width: width of the band at severity 1, over the extent.
        lean_deg: standard deviation of its slope, degrees.
        fringe: widest edge that the mask keeps, over the extent.
    """

    name: ClassVar[str] = "pole"

    weight: Weight = 1 / 3
    width: Positive = 0.14
    lean_deg: Positive = 2.0
    fringe: Share = 0.012

    def _run(self, rgba: Image, box: ObjectBox, severity: float, rng: np.random.Generator) -> Image:
        height, width = rgba.shape[:2]
        across = box.left + rng.uniform(0.1, 0.9) * box.width
        lean = np.tan(np.radians(self.lean_deg) * rng.standard_normal())
        colour = _POLE_COLOURS[rng.integers(len(_POLE_COLOURS))]
        fringe = rng.uniform(0, self.fringe) * box.extent
        rows = np.arange(height, dtype=np.float32)[:, None] - box.top - box.height / 2
        columns = np.arange(width, dtype=np.float32)[None, :] + 0.5
        half = severity * self.width * box.extent / 2
        offset = np.abs(columns - across - lean * rows)
        coverage = np.clip(half + 0.5 - offset, 0, min(1, 2 * half)).astype(np.float32)
        return occlude(rgba, coverage, colour, fringe)


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


class OtherVehicle(PerturbationKind):
    """The silhouette of a vehicle that comes in from the left or the right.

    Attributes:
        cover: share of the object's width that it has passed at severity 1.
        height: lowest and highest height of the occluder over the object's height, drawn uniformly.
        fringe: widest edge that the mask keeps, over the extent.
    """

    name: ClassVar[str] = "other-vehicle"

    weight: Weight = 1 / 3
    cover: Share = 0.5
    height: Positives = (0.8, 1.7)
    fringe: Share = 0.012

    def _run(self, rgba: Image, box: ObjectBox, severity: float, rng: np.random.Generator) -> Image:
        rows, columns = rgba.shape[:2]
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


class Cropping(PerturbationKind):
    """A straight cut by the picture's border: left or right, less often below or above.

    The picture keeps its size; what is cut off becomes transparent, and `crop_to_object` then
    centres what is left, as it does with a vehicle at the border of a log's picture.

    Attributes:
        cut: share of the object's width or height that is lost at severity 1.
    """

    name: ClassVar[str] = "cropping"

    cut: Share = 0.5

    def _run(self, rgba: Image, box: ObjectBox, severity: float, rng: np.random.Generator) -> Image:
        side = _CUT_SIDES[int(rng.choice(len(_CUT_SIDES), p=_CUT_CHANCES))]
        across = side in ("left", "right")
        lost = round(severity * self.cut * (box.width if across else box.height))
        out = rgba.copy()
        if lost == 0:
            return out
        if side == "left":
            out[:, : box.left + lost] = 0
        elif side == "right":
            out[:, box.right - lost :] = 0
        elif side == "bottom":
            out[box.bottom - lost :] = 0
        else:
            out[: box.top + lost] = 0
        return out


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
