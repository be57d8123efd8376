"""The seam of the quality filter, and a score for models too small to please the aesthetic one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from recast.arrays import Mask
from recast.recar.targets.cache import Target
from recast.recar.targets.views import (
    Cutout,
    Viewpoint,
    closeness,
    framed,
    iou,
    of_picture,
    render,
    turned,
)
from recast.recar.views import Image
from recast.splats import Gaussians

PIXELS = 96
"""Side of the cut-outs that are compared."""

WEIGHTS = {
    "iou": 0.4,
    "psnr": 0.2,
    "symmetry": 0.1,
    "connected": 0.1,
    "solid": 0.1,
    "sharpness": 0.1,
}
"""Exponents of the parts; they add up to one."""

_LEAST_IOU = 0.5
_LEAST = 1e-3
_NEIGHBOURS = np.ones((3, 3, 3), bool)


@dataclass(frozen=True)
class Candidate:
    """A target to judge.

    Attributes:
        target: its latents and voxels.
        gaussians: decoded, in the unit cube.
        pictures: front, rear, left, right that it was made from; RGBA with straight alpha.
        viewpoints: where they were taken from, azimuth 0 ahead of the vehicle.
        heading_deg: direction of the vehicle's front in the frame of the target, 0 along +x.
    """

    target: Target
    gaussians: Gaussians
    pictures: Sequence[Image]
    viewpoints: Sequence[Viewpoint]
    heading_deg: float = 0.0


@dataclass(frozen=True)
class Quality:
    """What a score says; more is better.

    Attributes:
        score: of the target.
        flipped: score with front and rear exchanged; None where the score cannot tell.
        parts: what the score is made of, by name.
    """

    score: float
    flipped: float | None = None
    parts: Mapping[str, float] = field(default_factory=dict)


class QualityScore(Protocol):
    """A way to judge targets.

    Attributes:
        name: under which scores are recorded.
        threshold: least score of a target that is used, where the user names none.
    """

    name: str
    threshold: float

    def __call__(self, candidate: Candidate) -> Quality:
        """Judge a target; the same target gets the same score."""
        ...


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

    The target is judged as it looks along `Candidate.heading_deg`. `flipped` is the same with front
    and rear exchanged: one that is higher tells of a vehicle that came out so. This is no measure
    of beauty and not comparable to the published predictor; the threshold is relative, a cut
    through the scores of one model.
    """

    name = "view-agreement"
    threshold = 0.6

    def __call__(self, candidate: Candidate) -> Quality:
        """See the class."""
        pictures = [framed(of_picture(picture), PIXELS) for picture in candidate.pictures]
        parts = {
            "symmetry": mirror_symmetry(candidate.target.coords, candidate.heading_deg),
            "connected": largest_part(candidate.target.coords),
        }
        own = parts | _agreement(pictures, _renders(candidate, 0.0))
        exchanged = parts | _agreement(pictures, _renders(candidate, 180.0))
        shown = {name: round(value, 6) for name, value in own.items()}
        return Quality(_mean(own), _mean(exchanged), shown)


def _renders(candidate: Candidate, turn_deg: float) -> list[Cutout]:
    made = []
    for view in candidate.viewpoints:
        seen_from = turned(view, candidate.heading_deg + turn_deg)
        whole = render(candidate.gaussians, seen_from, 2 * PIXELS)
        made.append(framed(whole, PIXELS))
    return made


def _mean(parts: dict[str, float]) -> float:
    """Weighted geometric mean: no part can make up for one that is nothing."""
    logs = [weight * np.log(max(parts[name], _LEAST)) for name, weight in WEIGHTS.items()]
    return round(float(np.exp(np.sum(logs))), 6)


def _agreement(pictures: Sequence[Cutout], renders: Sequence[Cutout]) -> dict[str, float]:
    pairs = list(zip(pictures, renders, strict=True))
    overlap = float(np.mean([iou(first.mask, second.mask) for first, second in pairs]))
    return {
        "iou": max(0.0, (overlap - _LEAST_IOU) / (1 - _LEAST_IOU)),
        "psnr": float(np.mean([closeness(first, second) for first, second in pairs])),
        "solid": float(np.mean([_solidity(shown.mask) for shown in renders])),
        "sharpness": float(np.mean([_sharpness(first, second) for first, second in pairs])),
    }


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


def mirror_symmetry(coords: NDArray[np.int32], heading_deg: float = 0.0) -> float:
    """Share of voxels (T, 3) with a voxel within one of their image in the middle plane.

    The plane is upright, along the heading, through the voxels' mean.
    """
    # The mean, not the middle of the bounding box, which one floating voxel would move.
    angle = np.radians(heading_deg)
    left = np.array([-np.sin(angle), np.cos(angle), 0.0])
    aside = (coords - coords.mean(axis=0)) @ left
    mirrored = np.floor(coords - 2 * aside[:, None] * left + 0.5).astype(np.int32)
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
