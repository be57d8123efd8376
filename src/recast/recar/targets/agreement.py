"""A stand-in for the aesthetic predictor, for models too small to please it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from recast.recar.targets.quality import Candidate, Quality
from recast.recar.targets.render import Cutout, framed, of_picture, render

Mask = NDArray[np.bool_]

PIXELS = 96
"""Side of the cut-outs that are compared."""

WEIGHTS = {
    "iou": 0.4, "psnr": 0.2, "symmetry": 0.1, "connected": 0.1, "solid": 0.1, "sharpness": 0.1,
}  # fmt: skip
"""Exponents of the parts; they add up to one."""

_PSNR_RANGE = (5.0, 25.0)  # dB on the vehicle that count as 0 and 1
_LEAST_IOU = 0.5
_LEAST = 1e-3
_NEIGHBOURS = np.ones((3, 3, 3), bool)


class AgreementScore:
    """How well a target agrees with the pictures it was made from, and whether it is sound.

    The weighted geometric mean, in (0, 1], of parts in [0, 1]:

    - iou: of the silhouettes of picture and render, mean over the four views, 0.5 as 0: any two
      vehicles reach that. Both are cut out at one scale, so that the unknown size of the asset
      does not matter;
    - psnr: of the colours where either shows the vehicle, 5 dB as 0 and 25 dB as 1;
    - symmetry: share of voxels with a voxel within one of their mirror image about the middle
      plane between left and right;
    - connected: share of voxels in the largest connected part: the rest floats;
    - solid: area of the silhouettes over that with their holes filled;
    - sharpness: mean gradient of the renders over that of the pictures, at most 1.

    The target must look along +x, as those of models trained on such assets do. `flipped` is the
    same for the target turned rear to front. This is no measure of beauty and not comparable to
    the published predictor; the threshold is relative, a cut through the scores of one model.
    """

    name = "view-agreement"
    threshold = 0.6

    def __call__(self, candidate: Candidate) -> Quality:
        """See the class."""
        pictures = [framed(of_picture(picture), PIXELS) for picture in candidate.pictures]
        parts = {
            "symmetry": mirror_symmetry(candidate.target.coords),
            "connected": largest_part(candidate.target.coords),
        }
        own = parts | _agreement(pictures, _renders(candidate, 0.0))
        turned = parts | _agreement(pictures, _renders(candidate, 180.0))
        shown = {name: round(value, 6) for name, value in own.items()}
        return Quality(_mean(own), _mean(turned), shown)


def _renders(candidate: Candidate, turn_deg: float) -> list[Cutout]:
    made = []
    for view in candidate.viewpoints:
        azimuth = (view.azimuth_deg + turn_deg) % 360.0
        whole = render(candidate.gaussians, replace(view, azimuth_deg=azimuth), 2 * PIXELS)
        made.append(framed(whole, PIXELS))
    return made


def _mean(parts: dict[str, float]) -> float:
    """Weighted geometric mean: no part can make up for one that is nothing."""
    logs = [weight * np.log(max(parts[name], _LEAST)) for name, weight in WEIGHTS.items()]
    return round(float(np.exp(np.sum(logs))), 6)


def _agreement(pictures: Sequence[Cutout], renders: Sequence[Cutout]) -> dict[str, float]:
    pairs = list(zip(pictures, renders, strict=True))
    low, high = _PSNR_RANGE
    psnr = np.mean([_psnr(first, second) for first, second in pairs])
    iou = float(np.mean([_iou(first.mask, second.mask) for first, second in pairs]))
    return {
        "iou": max(0.0, (iou - _LEAST_IOU) / (1 - _LEAST_IOU)),
        "psnr": float(np.clip((psnr - low) / (high - low), 0, 1)),
        "solid": float(np.mean([_solidity(shown.mask) for shown in renders])),
        "sharpness": float(np.mean([_sharpness(first, second) for first, second in pairs])),
    }


def _iou(first: Mask, second: Mask) -> float:
    union = np.count_nonzero(first | second)
    return float(np.count_nonzero(first & second) / union) if union else 0.0


def _psnr(first: Cutout, second: Cutout) -> float:
    seen = first.mask | second.mask
    if not seen.any():
        return 0.0
    error = float(np.mean(np.square(first.rgb[seen] - second.rgb[seen])))
    return float(-10.0 * np.log10(max(error, 1e-6)))


def _solidity(mask: Mask) -> float:
    filled = np.count_nonzero(ndimage.binary_fill_holes(mask))
    return float(np.count_nonzero(mask) / filled) if filled else 0.0


def _sharpness(picture: Cutout, shown: Cutout) -> float:
    wanted, found = _gradient(picture), _gradient(shown)
    return min(1.0, found / wanted) if wanted > 0 else 1.0


def _gradient(cutout: Cutout) -> float:
    """Mean length of the grey values' gradient inside the silhouette, its border left out."""
    inside = ndimage.binary_erosion(cutout.mask, iterations=2)
    if not inside.any():
        return 0.0
    grey = cutout.rgb.mean(axis=2)
    across, down = cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)
    return float(np.hypot(across, down)[inside].mean())


def mirror_symmetry(coords: NDArray[np.int32]) -> float:
    """Share of voxels (T, 3) with a voxel within one of their mirror image about mean y."""
    # The mean, not the middle of the bounding box, which one floating voxel would move.
    mirrored = coords.copy()
    mirrored[:, 1] = round(2 * float(coords[:, 1].mean())) - coords[:, 1]
    low = np.minimum(coords.min(axis=0), mirrored.min(axis=0))
    shape = np.maximum(coords.max(axis=0), mirrored.max(axis=0)) - low + 1
    grid = np.zeros(shape, bool)
    grid[tuple((coords - low).T)] = True
    near = ndimage.binary_dilation(grid, _NEIGHBOURS)
    return float(near[tuple((mirrored - low).T)].mean())


def largest_part(coords: NDArray[np.int32]) -> float:
    """Share of voxels (T, 3) in the largest part connected by faces, edges or corners."""
    local = coords - coords.min(axis=0)
    grid = np.zeros(local.max(axis=0) + 1, bool)
    grid[tuple(local.T)] = True
    labels, _ = ndimage.label(grid, _NEIGHBOURS)
    sizes = np.bincount(labels.ravel())[1:]
    return float(sizes.max() / sizes.sum())
