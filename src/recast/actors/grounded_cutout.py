"""Cutting a vehicle out of a photograph with Grounding DINO and SAM."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast.actors.cutout import BackgroundRemover, GrabCutRemover, mask_doubts
from recast.actors.detect import Detection, DetectionRule, rectangle_overlap, text_prompt
from recast.actors.grounded_segmenter import GroundedSamSegmenter
from recast.actors.mask_shapes import feather, large_pieces
from recast.actors.segment import Segmentation
from recast.errors import InputError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

DEFAULT_REMOVER = "grabcut"
_SPECK = 0.1  # as in `GroundedSamSegmenter`: pieces smaller than this share are noise
_SURE = 0.7


class GroundedSamRemover:
    """The networks of `GroundedSamSegmenter`, where there is no log to tell the box.

    Of what Grounding DINO detects as the vehicle's category, the largest that holds the middle of
    the picture is taken (area times score); where there is none, nearly all of the picture stands
    in, and the doubts say so. Of SAM's masks the one that fills its box best, and that SAM expects
    to be best, is taken.

    What has been run: small networks with random weights. How good the masks of the published
    weights are on photographs is not measured.

    Args:
        folder: see `GroundedSamSegmenter`.
        rule: only its score is used.
        device: torch device; None is CUDA where there is one, else the CPU.

    Raises:
        InputError: a folder or file is missing, of another network or incomplete.
    """

    def __init__(
        self, folder: str | Path, rule: DetectionRule | None = None, device: str | None = None
    ) -> None:
        self.networks = GroundedSamSegmenter(folder, rule, device)

    def remove(self, image: NDArray[np.uint8], category: str = "car") -> Segmentation:
        """See `BackgroundRemover.remove`.

        Raises:
            InputError: see the class; or SAM found nothing at all.
        """
        height, width = image.shape[:2]
        found = central_detection(self.networks.detect(image, text_prompt(category)), width, height)
        box = np.array([0.05 * width, 0.05 * height, 0.95 * width, 0.95 * height])
        doubts = [f"no {category} was detected in the middle of the picture"]
        if found is not None:
            box, doubts = found.box, []
        masks, predicted = self.networks.propose(image, box)
        scores = [_filling(mask, box) for mask in masks] + predicted
        best = int(np.argmax(np.where(masks.any(axis=(1, 2)), scores, -1.0)))
        if not masks[best].any():
            raise InputError(
                self.networks.sam.path, "mask", "is empty for this picture", "cut it out by hand"
            )
        mask = large_pieces(masks[best], _SPECK)
        if predicted[best] < _SURE:
            doubts.append(f"SAM expects its mask to be right by {predicted[best]:.2f} only")
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
    """A remover: "grabcut", or the folder that holds grounding-dino and sam.

    Raises:
        InputError: neither; see `GroundedSamRemover`.
    """
    if name_or_folder == DEFAULT_REMOVER:
        return GrabCutRemover()
    return GroundedSamRemover(name_or_folder)


def _weight(detection: Detection) -> float:
    left, top, right, bottom = detection.box
    return detection.score * float((right - left) * (bottom - top))


def _filling(mask: Mask, box: Array) -> float:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return 0.0
    around = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], np.float64)
    return rectangle_overlap(around, box)
