"""A segmenter that needs no weights: GrabCut between the projected box and the LiDAR."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.actors.mask_shapes import disc, feather, hull_mask, largest_piece, shorter_side, smooth
from recast.actors.segment import SegmentationTarget, project_box, project_points
from recast.geometry import se3

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_REACH = 0.06  # shares of the vehicle's extent in the image: how far it may reach beyond the hull
_GAP = 0.03
_SHRINK = (0.05, 0.012)  # across, where labels and poses are off by some centimetres; and up
_APRON = (0.10, 0.45)  # shares of the height: above the road, and dark like it


class BoxLidarSegmenter:
    """GrabCut between what the LiDAR hit on the vehicle and what lies outside its projected box.

    Sure foreground: the core of the hull of the vehicle's LiDAR points, and where they lie densely
    on its lower parts, whose dark apron and tyres look like the road. Sure
    background: outside the box (grown to hold the points), well outside the hull, on LiDAR returns
    of the scene, and under the body between the wheels, where a dark car's shadow looks like the
    car. Colour models and edges decide the rest; holes are filled and only the largest piece is
    kept. Without hits, the box's inside is where the colours begin.

    Args:
        iterations: of GrabCut.
        grow: metres by which the box is grown, since labels are often a little small.
    """

    def __init__(self, iterations: int = 6, grow: float = 0.08) -> None:
        self.iterations = iterations
        self.grow = grow

    def segment(self, target: SegmentationTarget) -> NDArray[np.uint8]:
        """See `Segmenter.segment`; the same crop always gives the same mask."""
        trimap = self.trimap(target)
        known = np.isin(trimap, (cv2.GC_FGD, cv2.GC_PR_FGD))
        if known.all() or not known.any():  # the box fills the crop, or is not in it
            return feather(known)
        background, foreground = np.zeros((1, 65)), np.zeros((1, 65))
        cv2.setRNGSeed(0)  # GrabCut seeds its colour clusters from OpenCV's global generator
        cv2.grabCut(
            np.ascontiguousarray(target.image[..., ::-1]), trimap, (0, 0, 1, 1),
            background, foreground, self.iterations, cv2.GC_INIT_WITH_MASK,
        )  # fmt: skip
        mask = (trimap == cv2.GC_FGD) | (trimap == cv2.GC_PR_FGD)
        mask = smooth(largest_piece(mask), 0.006 * shorter_side(trimap))
        return feather(mask)

    def trimap(self, target: SegmentationTarget) -> NDArray[np.uint8]:
        """GrabCut labels (H, W) before any look at the colours."""
        height, width = target.image.shape[:2]
        outline = _vehicle_outline(target, self.grow)
        trimap = np.where(outline, cv2.GC_PR_BGD, cv2.GC_BGD).astype(np.uint8)
        extent = shorter_side(outline)
        hits = _lidar_pixels(target, target.object_points)
        vehicle = hull_mask(hits, (height, width))
        if vehicle.any():
            # a car behind this one often has its colour; tyres may lie below all hits
            near = cv2.dilate(vehicle.astype(np.uint8), disc(_REACH * extent))
            trimap[np.maximum.accumulate(near, axis=0) == 0] = cv2.GC_BGD
        # without any hit on it, the vehicle is what fills its box
        inner = cv2.erode(outline.astype(np.uint8), disc(0.05 * extent)) > 0
        body = vehicle if vehicle.any() else inner
        trimap[body & outline] = cv2.GC_PR_FGD
        core = cv2.erode(vehicle.astype(np.uint8), disc(0.07 * extent)) > 0
        share = target.object_points[:, 2] / target.size[2] + 0.5
        apron = target.object_points[(share > _APRON[0]) & (share < _APRON[1])]
        core |= _dense(_lidar_pixels(target, apron), outline.shape, extent)
        trimap[core & outline] = cv2.GC_FGD
        pixels, depth = project_points(target.camera, target.other_points)
        behind = np.zeros((height, width), np.uint8)
        for (u, v), z in zip(pixels, depth, strict=True):
            if z > 0.5 and 0 <= u < width and 0 <= v < height:
                cv2.circle(behind, (int(u), int(v)), 1, 1, -1)
        trimap[(behind > 0) & ~core] = cv2.GC_BGD
        return trimap


def _vehicle_outline(target: SegmentationTarget, grow: float) -> Mask:
    """Where the vehicle can be: its body above the ground clearance, and its wheels."""
    half = target.size / 2
    low, high = -half, half.copy()
    if len(target.object_points):
        seen = np.quantile(target.object_points, [0.005, 0.995], axis=0)
        low[:2] = np.minimum(low[:2], seen[0, :2])
        high = np.maximum(high, seen[1])
    low[:2] -= grow
    high += grow
    floor = low[2]
    clearance, wheel_top = 0.13 * target.size[2], 0.45 * target.size[2]
    outline = project_box(target, np.array([*low[:2], floor + clearance]), high)
    for end in (0.30, -0.30):  # axles lie about 0.3 lengths from the middle
        for inner, outer in ((high[1] - 0.35, high[1]), (low[1], low[1] + 0.35)):
            x = end * target.size[0]
            reach = 0.11 * target.size[0]
            outline |= project_box(
                target, np.array([x - reach, inner, floor - 0.03]),
                np.array([x + reach, outer, floor + wheel_top]),
            )  # fmt: skip
    return outline


def _lidar_pixels(target: SegmentationTarget, object_points: Array) -> Array:
    """Pixels (N, 2) of points (M, 3) of the vehicle, without the loneliest two in a hundred."""
    points = se3.apply(target.camera_from_object, object_points)
    pixels, depth = project_points(target.camera, points)
    pixels = pixels[depth > 0.1]
    if len(pixels) == 0:
        return pixels
    cell = max(0.02 * min(target.image.shape[:2]), 1.0)
    _, which, count = np.unique(
        np.floor(pixels / cell), axis=0, return_inverse=True, return_counts=True
    )
    enough = count[which.ravel()] >= max(2.0, np.quantile(count, 0.02))
    kept: Array = pixels[enough]
    return kept


def _dense(pixels: Array, shape: tuple[int, ...], extent: float) -> Mask:
    """Where points (N, 2) lie closer than `_GAP` of the vehicle's extent, a little shrunk."""
    hit = np.zeros(shape, np.uint8)
    inside = np.all((pixels >= 0) & (pixels < [shape[1], shape[0]]), axis=1)
    u, v = pixels[inside].astype(int).T
    hit[v, u] = 1
    closed = cv2.morphologyEx(hit, cv2.MORPH_CLOSE, disc(_GAP * extent))
    across, up = (2 * max(round(share * extent), 1) + 1 for share in _SHRINK)
    shrunk: Mask = cv2.erode(closed, np.ones((up, across), np.uint8)) > 0
    return shrunk
