"""Small operations on masks (H, W): outline, extent, pieces, edges."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def hull_mask(pixels: Array, shape: tuple[int, int]) -> Mask:
    """Inside of the convex hull of pixels (N, 2) in a picture of `shape` (H, W)."""
    mask = np.zeros(shape, np.uint8)
    if len(pixels) >= 3:
        hull = cv2.convexHull(pixels.astype(np.float32))
        # a far corner of a cut box would overflow the fixed-point coordinates of fillConvexPoly
        cv2.fillConvexPoly(mask, np.clip(hull, -8000, 8000).astype(np.int32), 1)
    return mask > 0


def shorter_side(mask: NDArray[np.generic]) -> float:
    """Shorter side of the rectangle around what is not zero, pixels; 1 where all is."""
    rows, columns = np.nonzero(mask)
    if len(rows) == 0:
        return 1.0
    return float(min(np.ptp(rows), np.ptp(columns)) + 1)


def disc(radius: float) -> NDArray[np.uint8]:
    """Round structuring element of at least 3 by 3 pixels."""
    size = 2 * max(round(radius), 1) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), np.uint8)


def largest_piece(mask: Mask) -> Mask:
    """The largest connected piece with its holes filled."""
    labels, areas = _pieces(mask)
    return _filled(labels == 1 + int(np.argmax(areas))) if len(areas) else mask


def large_pieces(mask: Mask, share: float) -> Mask:
    """The connected pieces with at least `share` of the largest one's area, holes filled."""
    labels, areas = _pieces(mask)
    if len(areas) == 0:
        return mask
    return _filled(np.isin(labels, 1 + np.flatnonzero(areas >= share * areas.max())))


def _pieces(mask: Mask) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Number of the piece at every pixel (H, W), 0 for none, and the areas (P,) from piece 1 on."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    return np.asarray(labels, np.int32), np.asarray(stats[1:, cv2.CC_STAT_AREA], np.int32)


def _filled(mask: Mask) -> Mask:
    pieces = mask.astype(np.uint8)
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
