"""The box that a segmenter is prompted with: detections, judged by the logged 3D box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from recast.actors.segment import SegmentationTarget
from recast.arrays import Array
from recast.geometry import boxes

_PROMPTS = {
    "car": "a car.",
    "van": "a van. a car.",  # what labellers call a van, captions call either
    "truck": "a truck.",
    "bus": "a bus.",
    "tram": "a tram. a train.",
    "pedestrian": "a person.",
    "cyclist": "a cyclist. a bicycle.",
    "misc": "a vehicle.",
}


@dataclass(frozen=True)
class Detection:
    """One thing found by a detector.

    Attributes:
        box: (4,) left, top, right, bottom, pixels of the crop.
        score: confidence, 0 to 1.
        label: words of the prompt it was found by.
    """

    box: Array
    score: float
    label: str


@dataclass(frozen=True)
class DetectionRule:
    """Which detection is the logged vehicle.

    The rectangle around the projected 3D box is a little larger than the vehicle in it: on KITTI
    drive 0013 the two overlap by 0.66 to 0.92 (six tracks), other tracks' rectangles overlap it by
    at most 0.17. The threshold lies between.

    Attributes:
        score: detections below are left out; the usual threshold of Grounding DINO.
        overlap: intersection over union with the logged rectangle below which a detection is
            another vehicle.
        tie: overlaps that differ by no more than this are equal; the score decides.
    """

    score: float = 0.25
    overlap: float = 0.4
    tie: float = 0.05


@dataclass(frozen=True)
class BoxPrompt:
    """The box taken, and where it comes from.

    Attributes:
        box: (4,) left, top, right, bottom, pixels of the crop.
        detected: False where the logged box stood in for the detector.
        reason: why this box, in words.
    """

    box: Array
    detected: bool
    reason: str


def text_prompt(category: str) -> str:
    """What to ask the detector for: lower case phrases, each closed by a dot.

    Args:
        category: of a track; one that `recast.logs.Track` does not list is asked for by its name.
    """
    name = " ".join(category.lower().replace(".", " ").replace("_", " ").replace("-", " ").split())
    return _PROMPTS.get(name, f"a {name or 'vehicle'}.")


def logged_rectangle(target: SegmentationTarget) -> Array:
    """(4,) left, top, right, bottom of the projected 3D box, clipped to the crop, pixels.

    Raises:
        ValueError: no part of the box lies in the crop.
    """
    rectangle = boxes.project(target.size, target.camera_from_object, target.camera)
    if rectangle is not None:
        height, width = target.image.shape[:2]
        rectangle = np.clip(rectangle, 0, [width, height, width, height])
    if rectangle is None or np.any(rectangle[2:] <= rectangle[:2]):
        raise ValueError("SegmentationTarget: no part of the box lies in the crop")
    return rectangle


def rectangle_overlap(first: Array, second: Array) -> float:
    """Intersection over union of two rectangles (4,), left, top, right, bottom."""
    low, high = np.maximum(first[:2], second[:2]), np.minimum(first[2:], second[2:])
    common = float(np.prod(np.maximum(high - low, 0)))
    areas = [float(np.prod(np.maximum(r[2:] - r[:2], 0))) for r in (first, second)]
    union = sum(areas) - common
    return common / union if union > 0 else 0.0


def choose_box(
    detections: Sequence[Detection], logged: Array, rule: DetectionRule, prompt: str
) -> BoxPrompt:
    """The detection that is the logged vehicle, or the logged rectangle where none is.

    The largest overlap with the logged rectangle wins, so that a clearer vehicle beside it does
    not; of overlaps that are as good as equal, the higher score.

    Args:
        detections: of the crop, in any order.
        logged: (4,) see `logged_rectangle`.
        rule: thresholds.
        prompt: that was asked for, to be named in the reason.
    """
    found = [d for d in detections if d.score >= rule.score]
    if not found:
        return BoxPrompt(
            logged, False, f"nothing was detected as {prompt!r} with a score of {rule.score:.2f}"
        )
    overlaps = [rectangle_overlap(d.box, logged) for d in found]
    best = max(overlaps)
    if best < rule.overlap:
        return BoxPrompt(
            logged,
            False,
            f"of {len(found)} detected as {prompt!r} none overlaps the logged box by "
            f"{rule.overlap:.2f}, the best by {best:.2f}",
        )
    equal = [i for i, overlap in enumerate(overlaps) if overlap >= best - rule.tie]
    chosen = max(equal, key=lambda i: (found[i].score, overlaps[i]))
    return BoxPrompt(
        found[chosen].box,
        True,
        f"{found[chosen].label!r} detected with score {found[chosen].score:.2f}, overlap "
        f"{overlaps[chosen]:.2f} with the logged box, one of {len(found)}",
    )
