"""How a drawn vehicle looks beside its photograph: colour of the paint, sharpness, structure.

None of these needs weights. Each is a figure that a blurred, ghosted or wrongly coloured vehicle
changes where PSNR and SSIM hardly do.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from recast.arrays import Array, Mask
from recast.geometry.colour import cielab, linear_to_srgb, srgb_to_linear

if TYPE_CHECKING:
    from recast.metrics.actor_scores import ScoredCutout

_FINE, _COARSE = 0.004, 0.016  # of the vehicle's longer side: what lies between is sharpness
_EDGE = 0.02  # share of it beside the outline that does not count
_GAIN_RANGE = 0.6, 1.7  # of light by which photographs of one vehicle may differ
_SCALES, _CELLS, _ANGLES = 3, 16, 8
_STEADY = 0.02  # gradient below which a cell has no direction


def light_gain(first: Array, first_mask: Mask, other: Array, other_mask: Mask) -> Array:
    """(3,) factors of linear light that bring a photograph to the light of the first one.

    Both show one vehicle at one place: what surrounds it at the bottom of the picture, the floor,
    has the same colour in both. Beyond plausible factors, or without surroundings, there is none.

    Args:
        first, other: (H, W, 3) display values in [0, 1], with the surroundings.
        first_mask, other_mask: (H, W) pixels on the vehicle.
    """
    floors = []
    for image, mask in ((first, first_mask), (other, other_mask)):
        beside = ~cv2.dilate(mask.astype(np.uint8), np.ones((9, 9), np.uint8)).astype(bool)
        beside[: round(0.6 * len(beside))] = False
        if beside.sum() < 50:
            return np.ones(3)
        floors.append(np.median(srgb_to_linear(image[beside]), axis=0))
    gain = floors[0] / np.maximum(floors[1], 1e-3)
    low, high = _GAIN_RANGE
    return np.asarray(gain if low < gain.min() and gain.max() < high else np.ones(3))


def paint_distance(shown: Array, truth: Array, gain: Array) -> float:
    """CIE76 distance of the paints (3,) of render and photograph, both CIE Lab.

    Args:
        gain: (3,) factors of the photograph's linear light, see `light_gain`.
    """
    display = cv2.cvtColor(truth.reshape(1, 1, 3).astype(np.float32), cv2.COLOR_LAB2RGB)
    lit = linear_to_srgb(srgb_to_linear(np.asarray(display, np.float64)) * gain)
    return float(np.linalg.norm(shown - cielab(lit)[0, 0]))


def fine_energy_share(shown: Array, truth: Array, mask: Mask) -> float:
    """Share of the truth's high-frequency energy that an image has: 1 is as sharp, 0 is fog.

    Energy of light between two widths of Gaussians, in proportion to the vehicle's size, so that
    noise and JPEG blocks of a pixel or two do not count. More than the truth's energy counts as 1:
    the figure tells what is missing.

    Args:
        shown, truth: (H, W, 3) display values in [0, 1].
        mask: (H, W) pixels that both show; those near its outline are left out.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return 0.0
    side = float(max(np.ptp(rows), np.ptp(columns)) + 1)
    reach = max(1, round(_EDGE * side))
    inner = cv2.erode(mask.astype(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0
    if inner.sum() < 50:
        return 0.0
    energies = []
    for image in (shown, truth):
        light = cielab(image)[..., 0]
        fine, coarse = (
            cv2.GaussianBlur(light, (0, 0), max(s * side, 0.6)) for s in (_FINE, _COARSE)
        )
        energies.append(float(((fine - coarse)[inner] ** 2).mean()))
    return min(energies[0] / max(energies[1], 1e-9), 1.0)


def sharpness(shown: ScoredCutout, truth: ScoredCutout) -> float:
    """`fine_energy_share` where both vehicles are."""
    return fine_energy_share(shown.rgb, truth.rgb, shown.mask & truth.mask)


def structure_distance(shown: ScoredCutout, truth: ScoredCutout) -> float:
    """Distance in [0, 1] of what the pictures show, in cells at several scales; 0 is the same.

    Each cell has a histogram of edge directions weighed by their strength, the mean colour and the
    cover of the outline; cells are compared with a tolerance of a cell, so that a part that is a
    little aside costs less than one that is missing. Not a network: it ranks blur, ghosts, colours
    and wrong bodies, but knows nothing of what a lamp is.
    """
    rows, columns = (np.flatnonzero((shown.mask | truth.mask).any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return 0.0
    window = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    total = 0.0
    for scale in range(_SCALES):
        cells = _CELLS * 2**scale // 2
        one, other = (_cells(c.rgb[window], c.alpha[window], cells) for c in (shown, truth))
        covered = np.maximum(one[..., -1], other[..., -1]) > 0.1
        # the smaller of both ways: each cell against the nearest ones of the other
        apart = (_nearest_cell(one, other) + _nearest_cell(other, one)) / 2
        total += float(apart[covered].mean()) if covered.any() else 0.0
    return total / _SCALES


def _cells(rgb: Array, alpha: Array, cells: int) -> Array:
    """(cells, cells, F) features of a picture (H, W, 3) before black with alpha (H, W)."""
    side = cells * 12
    size = (side, side)
    small = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.float64)
    lab = cielab(small) / 100.0
    cover = cv2.resize(alpha.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    right, down = (cv2.Sobel(lab[..., 0], cv2.CV_64F, *d, ksize=3) / 4 for d in ((1, 0), (0, 1)))
    strength = np.hypot(right, down)
    angle = np.arctan2(down, right) % np.pi / np.pi * _ANGLES
    layers = [
        strength * np.maximum(1 - np.minimum(np.abs(angle - k), _ANGLES - np.abs(angle - k)), 0)
        for k in range(_ANGLES)
    ]
    edges = np.stack(
        [cv2.resize(one, (cells, cells), interpolation=cv2.INTER_AREA) for one in layers], -1
    )
    edges = edges / (np.linalg.norm(edges, axis=-1, keepdims=True) + _STEADY)
    rest = cv2.resize(np.dstack([2.0 * lab, cover]), (cells, cells), interpolation=cv2.INTER_AREA)
    return np.concatenate([edges, rest], axis=-1)


def _nearest_cell(one: Array, other: Array) -> Array:
    """(N, N) distance of each cell of one to the most alike of nine cells of the other."""
    padded = np.pad(other, ((1, 1), (1, 1), (0, 0)), mode="edge")
    size = one.shape[0]
    away = [
        np.sqrt(((one - padded[y : y + size, x : x + size]) ** 2).sum(axis=-1))
        + 0.05 * (x != 1 or y != 1)
        for y in range(3)
        for x in range(3)
    ]
    return np.asarray(np.minimum(np.min(away, axis=0) / np.sqrt(2.0), 1.0))
