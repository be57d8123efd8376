"""Cutting a vehicle out of a photograph of which nothing is known but that it shows one.

A `Segmenter` knows camera, box and LiDAR from a log; a photograph from a turntable or a car park
has none of them. What is known instead: the vehicle is the large thing in the middle, and along
the borders of the picture there is background. GrabCut cuts by that, or Grounding DINO with SAM.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.actors.grounded_segmenter import (
    Detection,
    DetectionRule,
    GroundedSamSegmenter,
    rectangle_overlap,
    text_prompt,
)
from recast.actors.segment import (
    Segmentation,
    disc,
    feather,
    grabcut,
    large_pieces,
    largest_piece,
    mask_rectangle,
    shorter_side,
    smooth,
)
from recast.arrays import Image, Mask
from recast.core.errors import InputError

SMALLEST_SHARE, LARGEST_SHARE = 0.02, 0.90
_WORKING_SIDE = 512  # pixels of the longer side on which GrabCut runs first
_FRAME = 0.025  # share of the shorter side along the borders that is background
_BACKGROUNDS = 6  # colours of it
_GAP = 0.012  # of the longer side: narrower gaps in what is unlike the border are closed
_FULL = 0.6  # share of the picture above which what is unlike the border is no vehicle
_CORE, _REACH = 0.08, 0.10  # of the vehicle's shorter side: sure within, never beyond
_BAND = 0.006  # share of the longer side about the outline that is decided at full size
_TOUCH = 0.10  # share of the border above which a mask has hardly found a vehicle
DEFAULT_REMOVER = "grabcut"
_SPECK = 0.1  # as in `GroundedSamSegmenter`: pieces smaller than this share are noise
_SURE = 0.7


class BackgroundRemover(Protocol):
    """Separates the one vehicle of a photograph from its background."""

    def remove(self, image: Image, category: str) -> Segmentation:
        """The mask of the one vehicle, whole, that a picture (H, W, 3) uint8 RGB shows.

        Args:
            category: category of the vehicle, see `recast.logs.Track`.

        Raises:
            InputError: no vehicle was found.
        """


class GrabCutRemover:
    """GrabCut that starts from the colours along the borders; needs no weights.

    Colours that are far, in CIELAB, from those of the border frame (and from a slope fitted to
    them) and lie towards the middle are taken for the vehicle at first; colour models and edges
    decide from there, on a small picture, and once more at full size about the outline.

    Made for an even background: studio, turntable, wall and floor. On renders of six vehicles
    before such ones it finds the whole vehicle, but keeps a strong shadow under it: median overlap
    0.88 and 0.85 with the true mask. It is of no use before a street (median 0.5, and less on
    photographs from driving logs), which `Segmentation.doubts` says where it is noticed.
    1.5 s on one CPU core for 1200 x 800 pixels.
    """

    def remove(self, image: Image, category: str = "car") -> Segmentation:
        """See `BackgroundRemover.remove`; the same picture always gives the same mask."""
        height, width = image.shape[:2]
        shrink = min(1.0, _WORKING_SIDE / max(height, width))
        size = (max(round(width * shrink), 1), max(round(height * shrink), 1))
        small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        trimap, told = border_trimap(small)
        mask = grabcut(small, trimap, 5)
        mask = smooth(largest_piece(mask), 0.004 * max(size)) if mask.any() else mask
        if shrink < 1 and mask.any():
            mask = _refined(image, mask)
        doubts = mask_doubts(mask)
        if not told:
            doubts = ("the vehicle has the colours of the border", *doubts)
        return Segmentation(feather(mask), ("GrabCut from the border",), doubts)


def mask_doubts(mask: Mask) -> tuple[str, ...]:
    """What looks wrong about the mask (H, W) of a vehicle that fills the middle of its picture."""
    doubts: list[str] = []
    share = float(mask.mean())
    if share < SMALLEST_SHARE or share > LARGEST_SHARE:
        doubts.append(f"the mask covers {100 * share:.1f} % of the image")
    border = np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]])
    if border.mean() > _TOUCH:
        doubts.append(f"the mask touches {100 * border.mean():.0f} % of the image's border")
    return tuple(doubts)


def border_trimap(image: Image) -> tuple[Image, bool]:
    """GrabCut labels (H, W) from the colours along the border of a picture (H, W, 3).

    Also whether these colours told vehicle from background; if not, the labels are an ellipse.
    """
    height, width = image.shape[:2]
    lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB).astype(np.float32)
    frame = np.ones((height, width), bool)
    edge = max(round(_FRAME * min(height, width)), 1)
    frame[edge:-edge, edge:-edge] = False
    distance = _unlike_border(np.asarray(cv2.GaussianBlur(lab, (0, 0), 1.0), np.float32), frame)
    typical = float(np.quantile(distance[frame], 0.98))
    y, x = np.mgrid[0:height, 0:width]
    across, upright = (x - width / 2) / width, (y - height / 2) / height
    middle = np.hypot(across / 0.49, upright / 0.47) < 1
    unlike = (distance > 1.3 * typical + 2.0) & middle
    closed = cv2.morphologyEx(
        unlike.astype(np.uint8), cv2.MORPH_CLOSE, disc(_GAP * max(height, width))
    )
    likely = large_pieces(smooth(closed > 0, 0.01 * max(height, width)), 0.3)
    told = SMALLEST_SHARE < likely.mean() < _FULL
    if not told:
        likely = np.hypot(across / 0.36, upright / 0.24) < 1
    trimap = np.where(likely, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    core = cv2.erode(likely.astype(np.uint8), disc(_CORE * shorter_side(likely))) > 0
    trimap[core] = cv2.GC_FGD
    reach = cv2.dilate(likely.astype(np.uint8), disc(_REACH * shorter_side(likely)))
    trimap[(reach == 0) | frame] = cv2.GC_BGD
    return trimap, told


def _unlike_border(lab: NDArray[np.float32], frame: Mask) -> NDArray[np.float32]:
    """Distance (H, W) of colours to the nearest of the border, or to a slope fitted to it."""
    height, width = frame.shape
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    terms = np.stack([np.ones_like(x), x, y, x * y, x * x, y * y], axis=-1).astype(np.float32)
    weights, *_ = np.linalg.lstsq(terms[frame], lab[frame], rcond=None)
    slope = np.linalg.norm(lab - terms @ weights, axis=-1)
    nearest = np.min(
        [np.linalg.norm(lab - colour, axis=-1) for colour in _clusters(lab[frame])], axis=0
    )
    return np.asarray(np.minimum(slope, nearest), np.float32)


def _clusters(colours: NDArray[np.float32]) -> NDArray[np.float32]:
    count = min(_BACKGROUNDS, len(np.unique(colours, axis=0)))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 0.5)
    cv2.setRNGSeed(0)
    _, _, centres = cv2.kmeans(
        np.ascontiguousarray(colours), count, np.zeros(0), criteria, 1, cv2.KMEANS_PP_CENTERS
    )
    return np.asarray(centres, np.float32)


def _refined(image: Image, coarse: Mask) -> Mask:
    """The outline of a coarse mask (h, w) decided anew at the size of the picture (H, W, 3)."""
    height, width = image.shape[:2]
    grown = cv2.resize(coarse.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
    mask = (grown > 0.5).astype(np.uint8)
    element = disc(_BAND * max(height, width))
    inner, outer = cv2.erode(mask, element), cv2.dilate(mask, element)
    trimap = np.where(mask > 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    trimap[inner > 0], trimap[outer == 0] = cv2.GC_FGD, cv2.GC_BGD
    around, room = mask_rectangle(outer), 2 * element.shape[0]
    assert around is not None  # the coarse mask is not empty
    left, top, right, bottom = np.add(around, [-room, -room, room, room]).astype(int).clip(0)
    part = np.s_[top:bottom, left:right]
    refined = np.zeros((height, width), bool)
    refined[part] = grabcut(image[part], trimap[part], 1)
    return smooth(largest_piece(refined), 0.001 * max(height, width))


class GroundedSamRemover:
    """The networks of `GroundedSamSegmenter`, where there is no log to tell the box.

    Of what Grounding DINO detects as the vehicle's category, the largest that holds the middle of
    the picture is taken (area times score); where there is none, nearly all of the picture stands
    in, and the doubts say so. Of SAM's masks the one that fills its box best, and that SAM expects
    to be best, is taken.

    What has been run: small networks with random weights. How good the masks of the published
    weights are on photographs is not measured.

    Arguments and errors are those of `GroundedSamSegmenter`; of the rule only the score is used.
    """

    def __init__(
        self, folder: str | Path, rule: DetectionRule | None = None, device: str | None = None
    ) -> None:
        self.networks = GroundedSamSegmenter(folder, rule, device)

    def remove(self, image: NDArray[np.uint8], category: str = "car") -> Segmentation:
        """See `BackgroundRemover.remove`. Raises InputError: see the class; or SAM found nothing at
        all."""
        height, width = image.shape[:2]
        found = central_detection(self.networks.detect(image, text_prompt(category)), width, height)
        box = np.array([0.05 * width, 0.05 * height, 0.95 * width, 0.95 * height])
        doubts = [f"no {category} was detected in the middle of the image"]
        if found is not None:
            box, doubts = found.box, []
        masks, predicted = self.networks.propose(image, box)
        around = [mask_rectangle(mask) for mask in masks]
        filled = [0.0 if one is None else rectangle_overlap(one, box) for one in around]
        scores = np.add(filled, predicted)
        best = int(np.argmax(np.where(masks.any(axis=(1, 2)), scores, -1.0)))
        if not masks[best].any():
            raise InputError(
                self.networks.sam.path,
                "mask",
                "is empty for this image",
                "cut the vehicle out by hand",
            )
        mask = large_pieces(masks[best], _SPECK)
        if predicted[best] < _SURE:
            doubts.append(f"SAM predicts an overlap of only {predicted[best]:.2f} for its mask")
        return Segmentation(
            feather(mask), (f"mask {best + 1} of {len(masks)}",), (*doubts, *mask_doubts(mask))
        )


def central_detection(detections: Sequence[Detection], width: int, height: int) -> Detection | None:
    """The largest detection, area times score, that holds the middle of the picture."""
    holding = [
        one
        for one in detections
        if one.box[0] < width / 2 < one.box[2] and one.box[1] < height / 2 < one.box[3]
    ]
    return max(holding, key=_weight, default=None)


def remover_of(name_or_folder: str) -> BackgroundRemover:
    """A remover: "grabcut", or the folder that holds grounding-dino and sam. Raises InputError:
    neither; see `GroundedSamRemover`."""
    if name_or_folder == DEFAULT_REMOVER:
        return GrabCutRemover()
    return GroundedSamRemover(name_or_folder)


def _weight(detection: Detection) -> float:
    left, top, right, bottom = detection.box
    return detection.score * float((right - left) * (bottom - top))
