"""The `Segmenter` seam: what a segmenter is given, what it gives back, and how good that is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from recast.actors.mask_shapes import hull_mask
from recast.actors.observation import MaskQuality
from recast.geometry import PinholeCamera, boxes, se3

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


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
        category: of the object, see `recast.logs.Track`.
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
    """Segment, whichever of the two forms the segmenter answers in.

    Raises:
        ValueError: the alpha is not (H, W) uint8 of the crop's size.
    """
    found = segmenter.segment(target)
    segmentation = found if isinstance(found, Segmentation) else Segmentation(found)
    alpha = segmentation.alpha
    if alpha.shape != target.image.shape[:2] or alpha.dtype != np.uint8:
        raise ValueError(
            f"{type(segmenter).__name__}.segment: alpha {target.image.shape[:2]} uint8 expected, "
            f"got {alpha.shape} {alpha.dtype}"
        )
    return segmentation


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
