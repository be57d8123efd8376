"""The `Segmenter` seam, and the segmenter that needs no weights: GrabCut between box and LiDAR.

What a segmenter is given, what it gives back, how good that is, and operations on masks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.actors.observation import MaskQuality
from recast.arrays import Array, Mask
from recast.cameras import PinholeCamera
from recast.core.foreign import foreign_call, read_only
from recast.geometry import boxes, se3
from recast.logs.types import PEOPLE

_REACH = 0.06  # shares of the vehicle's extent in the image: how far it may reach beyond the hull
_GAP = 0.03
_ITERATIONS = 6  # of GrabCut
_GROWTH = 0.08  # metres by which the box is grown: labels are often a little small
_SHRINK = (0.05, 0.012)  # across, where labels and poses are off by some centimetres; and up
_APRON = (0.10, 0.45)  # shares of the height: above the road, and dark like it
# In halves of a person's box, low and high; a rider's head is ahead.
_TRUNK = ((-0.15, -0.3, 0.05), (0.15, 0.3, 0.65))
_HEAD = {"pedestrian": ((-0.1, -0.15, 0.78), (0.15, 0.15, 0.96))}
_HEAD["cyclist"] = ((0.1, -0.1, 0.82), (0.3, 0.1, 0.96))
_LIMB = 0.06  # of its narrower side: what is near a LiDAR point may be the person


@dataclass(frozen=True)
class SegmentationTarget:
    """A crop with everything known about the object in it.

    Attributes:
        image: (H, W, 3) uint8 RGB crop.
        camera: pinhole of the crop, without distortion.
        camera_from_object: (4, 4).
        size: (3,) length, width, height of the object's box, metres.
        object_points: (N, 3) LiDAR points on the object over all sweeps, object frame.
        other_points: (M, 3) LiDAR points of the scene near this time that are not on the object,
            camera frame; empty where there was no sweep.
        category: category of the object, see `recast.logs.Track`.
    """

    image: NDArray[np.uint8]
    camera: PinholeCamera
    camera_from_object: Array
    size: Array
    object_points: Array
    other_points: Array
    category: str = "car"


@dataclass(frozen=True)
class Segmentation:
    """A mask, and how its segmenter came to it.

    Attributes:
        alpha: (H, W) uint8, 255 on the object.
        notes: how the mask was made, a line each.
        doubts: what a person should look at, such as a part that stood in for another.
    """

    alpha: NDArray[np.uint8]
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


class Segmenter(Protocol):
    """Separates an object from its background."""

    def segment(self, target: SegmentationTarget) -> Segmentation | NDArray[np.uint8]:
        """The mask; where there is nothing to say about it, its alpha (H, W) uint8 alone."""


def run_segmenter(segmenter: Segmenter, target: SegmentationTarget) -> Segmentation:
    """Segment, whichever of the two forms the segmenter answers in. Raises ValueError: the alpha is
    not (H, W) uint8 of the crop's size."""
    with foreign_call(f"segmenter {type(segmenter).__name__}", "segment", segmenter):
        found = segmenter.segment(read_only(target))
    segmentation = found if isinstance(found, Segmentation) else Segmentation(found)
    alpha = np.array(segmentation.alpha)
    if alpha.shape != target.image.shape[:2] or alpha.dtype != np.uint8:
        raise ValueError(
            f"{type(segmenter).__name__}.segment: expected alpha {target.image.shape[:2]} uint8, "
            f"got {alpha.shape} {alpha.dtype}"
        )
    return replace(segmentation, alpha=alpha)


def project_points(camera: PinholeCamera, points: Array) -> tuple[Array, Array]:
    """Pixels (N, 2) and depths (N,) of camera-frame points (N, 3), of which there may be none."""
    return camera.project(points) if len(points) else (np.zeros((0, 2)), np.zeros(0))


def project_box(target: SegmentationTarget, low: Array, high: Array) -> Mask:
    """Outline (H, W) of the object-frame box between two corners (3,)."""
    corners = boxes.corners(high - low) + (low + high) / 2
    pixels, depth = target.camera.project(se3.apply(target.camera_from_object, corners))
    return hull_mask(pixels[depth > 0.1], (target.image.shape[0], target.image.shape[1]))


def mask_quality(
    target: SegmentationTarget, found: Segmentation | NDArray[np.uint8]
) -> MaskQuality:
    """Judge a mask by the box, the crop's border and the LiDAR; keep its segmenter's words."""
    segmentation = found if isinstance(found, Segmentation) else Segmentation(found)
    mask = segmentation.alpha > 127
    outline = project_box(target, -target.size / 2, target.size / 2)
    border = np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]])

    on_object, on_other = lidar_shares(target, mask)
    return MaskQuality(
        box_coverage=float((mask & outline).sum() / max(int(outline.sum()), 1)),
        border_contact=float(border.mean()),
        lidar_inside=on_object,
        lidar_outside=1.0 - on_other if np.isfinite(on_other) else 1.0,
        notes=segmentation.notes,
        doubts=segmentation.doubts,
    )


def lidar_shares(target: SegmentationTarget, mask: Mask) -> tuple[float, float]:
    """Shares of the object's and of the scene's projected LiDAR points that lie in a mask (H, W).

    NaN where there are no such points in the crop.
    """
    height, width = mask.shape

    def share(points: Array) -> float:
        pixels, depth = project_points(target.camera, points)
        inside = (depth > 0.1) & np.all((pixels >= 0) & (pixels < [width, height]), axis=1)
        u, v = pixels[inside].astype(int).T
        return float(mask[v, u].mean()) if inside.any() else float("nan")

    on_object = se3.apply(target.camera_from_object, target.object_points)
    return share(on_object), share(target.other_points)


def hull_mask(pixels: Array, shape: tuple[int, int]) -> Mask:
    """Inside of the convex hull of pixels (N, 2) in a picture of `shape` (H, W)."""
    mask = np.zeros(shape, np.uint8)
    if len(pixels) >= 3:
        hull = cv2.convexHull(pixels.astype(np.float32))
        # a far corner of a cut box would overflow the fixed-point coordinates of fillConvexPoly
        cv2.fillConvexPoly(mask, np.clip(hull, -8000, 8000).astype(np.int32), 1)
    return mask > 0


def mask_rectangle(mask: NDArray[np.generic]) -> Array | None:
    """(4,) left, top, right, bottom of the rectangle around what is not zero; None where all is."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return None
    return np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], np.float64)


def shorter_side(mask: NDArray[np.generic]) -> float:
    """Shorter side of `mask_rectangle`, pixels; 1 where there is none."""
    around = mask_rectangle(mask)
    return 1.0 if around is None else float(np.min(around[2:] - around[:2]))


def grabcut(image: NDArray[np.uint8], trimap: NDArray[np.uint8], iterations: int) -> Mask:
    """The foreground (H, W) of a picture (H, W, 3), from GrabCut labels (H, W)."""
    trimap = trimap.copy()
    if np.isin(trimap, (cv2.GC_FGD, cv2.GC_PR_FGD)).any():
        background, foreground = np.zeros((1, 65)), np.zeros((1, 65))
        cv2.setRNGSeed(0)  # GrabCut seeds its colour clusters from OpenCV's global generator
        cv2.grabCut(
            np.ascontiguousarray(image[..., ::-1]),
            trimap,
            (0, 0, 1, 1),
            background,
            foreground,
            iterations,
            cv2.GC_INIT_WITH_MASK,
        )
    return np.isin(trimap, (cv2.GC_FGD, cv2.GC_PR_FGD))


def disc(radius: float) -> NDArray[np.uint8]:
    """Round structuring element of at least 3 by 3 pixels."""
    size = 2 * max(round(radius), 1) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), np.uint8)


def largest_piece(mask: Mask) -> Mask:
    """The largest connected piece with its holes filled."""
    return large_pieces(mask, 1.0)


def large_pieces(mask: Mask, share: float) -> Mask:
    """The connected pieces with at least `share` of the largest one's area, holes filled."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    areas = np.asarray(stats[1:, cv2.CC_STAT_AREA])
    if len(areas) == 0:
        return mask
    kept = np.isin(np.asarray(labels), 1 + np.flatnonzero(areas >= share * areas.max()))
    pieces = kept.astype(np.uint8)
    contours, _ = cv2.findContours(pieces, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(pieces, contours, -1, 1, thickness=-1)
    return pieces > 0


def smooth(mask: Mask, radius: float) -> Mask:
    """Remove spikes and notches narrower than `radius` pixels."""
    element = disc(max(radius, 1.0))
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, element)
    closed = cv2.morphologyEx(opened, cv2.MORPH_CLOSE, element)
    return largest_piece(closed > 0)


def feather(mask: Mask) -> NDArray[np.uint8]:
    """Alpha with an edge one pixel soft."""
    alpha = cv2.GaussianBlur(mask.astype(np.float32) * 255, (3, 3), 0.6)
    return np.round(alpha).astype(np.uint8)


class BoxLidarSegmenter:
    """GrabCut between what the LiDAR hit on the vehicle and what lies outside its projected box.

    Sure foreground: the core of the hull of the vehicle's LiDAR points, and where they lie densely
    on its lower parts, whose dark apron and tyres look like the road. Sure
    background: outside the box (grown to hold the points), well outside the hull, on LiDAR returns
    of the scene, and under the body between the wheels, where a dark car's shadow looks like the
    car. Colour models and edges decide the rest; holes are filled and only the largest piece is
    kept. Without hits, the box's inside is where the colours begin.
    """

    def segment(self, target: SegmentationTarget) -> NDArray[np.uint8]:
        """See `Segmenter.segment`; the same crop always gives the same mask."""
        person = target.category in PEOPLE
        trimap = person_trimap(target) if person else self.trimap(target)
        known = np.isin(trimap, (cv2.GC_FGD, cv2.GC_PR_FGD))
        if known.all() or not known.any():  # the box fills the crop, or is not in it
            return feather(known)
        mask = grabcut(target.image, trimap, _ITERATIONS)
        if person:  # smoothing would take the limbs
            return feather(largest_piece(mask))
        return feather(smooth(largest_piece(mask), 0.006 * shorter_side(trimap)))

    def trimap(self, target: SegmentationTarget) -> NDArray[np.uint8]:
        """GrabCut labels (H, W) before any look at the colours."""
        height, width = target.image.shape[:2]
        outline = _vehicle_outline(target)
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
        cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
        trimap[(cv2.dilate(_behind(target), cross) > 0) & ~core] = cv2.GC_BGD
        return trimap


def person_trimap(target: SegmentationTarget) -> NDArray[np.uint8]:
    """GrabCut labels (H, W) of a pedestrian or cyclist: trunk and head in the middle of the box for
    sure, a body around them perhaps, and other LiDAR returns and all outside of the box not."""
    half = target.size / 2
    outline = project_box(target, -half - [_GROWTH, _GROWTH, 0.03], half + _GROWTH)
    body = project_box(target, half * [-0.75, -0.75, -1.0], half * [0.75, 0.75, 1.0])
    core = np.zeros(outline.shape, bool)
    for low, high in (_TRUNK, _HEAD[target.category]):
        core |= project_box(target, np.array(low) * half, np.array(high) * half)
    trimap = np.where(outline, cv2.GC_PR_BGD, cv2.GC_BGD).astype(np.uint8)
    near = _marked(_lidar_pixels(target, target.object_points), outline.shape)
    around = cv2.dilate(near, disc(_LIMB * shorter_side(outline))) > 0
    trimap[outline & body & (around | (not near.any()))] = cv2.GC_PR_FGD
    trimap[_behind(target) > 0] = cv2.GC_BGD
    trimap[core & outline] = cv2.GC_FGD
    return trimap


def _vehicle_outline(target: SegmentationTarget) -> Mask:
    """Where the vehicle can be: its body above the ground clearance, and its wheels."""
    half = target.size / 2
    low, high = -half, half.copy()
    if len(target.object_points):
        seen = np.quantile(target.object_points, [0.005, 0.995], axis=0)
        low[:2] = np.minimum(low[:2], seen[0, :2])
        high = np.maximum(high, seen[1])
    low[:2] -= _GROWTH
    high += _GROWTH
    floor = low[2]
    clearance, wheel_top = 0.13 * target.size[2], 0.45 * target.size[2]
    outline = project_box(target, np.array([*low[:2], floor + clearance]), high)
    for end in (0.30, -0.30):  # axles lie about 0.3 lengths from the middle
        for inner, outer in ((high[1] - 0.35, high[1]), (low[1], low[1] + 0.35)):
            x = end * target.size[0]
            reach = 0.11 * target.size[0]
            outline |= project_box(
                target,
                np.array([x - reach, inner, floor - 0.03]),
                np.array([x + reach, outer, floor + wheel_top]),
            )
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
    return pixels[enough]


def _behind(target: SegmentationTarget) -> NDArray[np.uint8]:
    """(H, W) 1 where LiDAR points of the scene are seen."""
    pixels, depth = project_points(target.camera, target.other_points)
    return _marked(pixels[depth > 0.5], target.image.shape[:2])


def _marked(pixels: Array, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """A picture (H, W) of zeros with 1 at pixels (N, 2), as far as they lie in it."""
    marked = np.zeros(shape, np.uint8)
    inside = np.all((pixels >= 0) & (pixels < [shape[1], shape[0]]), axis=1)
    u, v = pixels[inside].astype(int).T
    marked[v, u] = 1
    return marked


def _dense(pixels: Array, shape: tuple[int, ...], extent: float) -> Mask:
    """Where points (N, 2) lie closer than `_GAP` of the vehicle's extent, a little shrunk."""
    closed = cv2.morphologyEx(_marked(pixels, shape), cv2.MORPH_CLOSE, disc(_GAP * extent))
    across, up = (2 * max(round(share * extent), 1) + 1 for share in _SHRINK)
    return cv2.erode(closed, np.ones((up, across), np.uint8)) > 0
