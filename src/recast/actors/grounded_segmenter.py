"""Grounding DINO for the box, box-prompted SAM for the mask; and segmenters by name or folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from recast.actors.segment import (
    Segmentation,
    SegmentationTarget,
    Segmenter,
    feather,
    large_pieces,
    lidar_shares,
    mask_rectangle,
)
from recast.arrays import Array, Mask
from recast.cameras import box_rectangle
from recast.core.errors import InputError
from recast.core.plugins import SEGMENTERS
from recast.pretrained import PretrainedFolder

_PROMPTS = {
    "car": "a car.",
    "van": "a van. a car.",  # what labellers call a van, captions call either
    "truck": "a truck.",
    "bus": "a bus.",
    "tram": "a tram. a train.",
    "pedestrian": "a person.",
    "cyclist": "a cyclist. a bicycle.",
    "motorcyclist": "a motorcycle.",
    "trailer": "a trailer.",
    "misc": "a vehicle.",
}
DETECTOR_FOLDER = "grounding-dino"
SAM_FOLDER = "sam"
_SPECK = 0.1  # pieces smaller than this share of the largest are noise; a pole may halve a vehicle
_SURE = 0.7  # predicted overlap below which a person should look at the mask
DEFAULT_SEGMENTER = "box-lidar"


@dataclass(frozen=True)
class Detection:
    """One thing found by a detector."""

    box: Array  # (4,) left, top, right, bottom, pixels of the crop
    score: float  # confidence, 0 to 1
    label: str  # words of the prompt it was found by


@dataclass(frozen=True)
class DetectionRule:
    """Which detection is the logged vehicle.

    The rectangle around the projected 3D box is a little larger than the vehicle in it: on KITTI
    drive 0013 the two overlap by 0.66 to 0.92 (six tracks), other tracks' rectangles overlap it by
    at most 0.17. The threshold lies between.
    """

    score: float = 0.25  # detections below are left out; the usual threshold of Grounding DINO
    # intersection over union with the logged rectangle below which a detection is another vehicle.
    overlap: float = 0.4
    tie: float = 0.05  # overlaps that differ by no more than this are equal; the score decides


@dataclass(frozen=True)
class BoxPrompt:
    """The box taken, and where it comes from."""

    box: Array  # (4,) left, top, right, bottom, pixels of the crop
    detected: bool  # False where the logged box stood in for the detector
    reason: str  # why this box, in words


def text_prompt(category: str) -> str:
    """What to ask the detector for: lower case phrases, each closed by a dot.

    A category that `recast.logs.Track` does not list is asked for by its name.
    """
    name = " ".join(category.lower().replace(".", " ").replace("_", " ").replace("-", " ").split())
    return _PROMPTS.get(name, f"a {name or 'vehicle'}.")


def logged_rectangle(target: SegmentationTarget) -> Array:
    """(4,) left, top, right, bottom of the projected 3D box, clipped to the crop, pixels. Raises
    ValueError: no part of the box lies in the crop."""
    rectangle = box_rectangle(target.size, target.camera_from_object, target.camera)
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
    """The detection that is the logged vehicle, or the logged rectangle (4,) where none is.

    The largest overlap with the logged rectangle wins, so that a clearer vehicle beside it does
    not; of overlaps that are as good as equal, the higher score. The reason names the prompt.

    Args:
        detections: detections in the crop, in any order.
        logged: (4,) see `logged_rectangle`.
        rule: thresholds.
        prompt: prompt that the detector was given.
    """
    found = [d for d in detections if d.score >= rule.score]
    if not found:
        return BoxPrompt(
            logged, False, f"no object was detected as {prompt!r} with a score of {rule.score:.2f}"
        )
    overlaps = [rectangle_overlap(d.box, logged) for d in found]
    best = max(overlaps)
    if best < rule.overlap:
        return BoxPrompt(
            logged,
            False,
            f"none of the {len(found)} objects detected as {prompt!r} overlaps the logged box by "
            f"{rule.overlap:.2f} (best: {best:.2f})",
        )
    equal = [i for i, overlap in enumerate(overlaps) if overlap >= best - rule.tie]
    chosen = max(equal, key=lambda i: (found[i].score, overlaps[i]))
    return BoxPrompt(
        found[chosen].box,
        True,
        f"{found[chosen].label!r} detected with score {found[chosen].score:.2f}, overlap "
        f"{overlaps[chosen]:.2f} with the logged box, 1 of {len(found)} detections",
    )


class GroundedSamSegmenter:
    """The segmentation of the RECAST paper, its box chosen by what the log knows.

    Grounding DINO looks for the track's category in the crop. Of what it finds, the detection that
    overlaps the projected 3D box most is taken, see `choose_box`. Where it finds nothing, or
    nothing that overlaps, the projected box stands in, and `Segmentation.doubts` says so. SAM,
    prompted with the box, proposes several masks (whole and parts); predicted quality and agreement
    with box and LiDAR decide, see `choose_mask`. Specks are dropped and holes filled.

    The crop needs some surroundings, as those of `observe` have. Networks are read at the first
    crop and kept. What has been run: small networks, and the sizes of grounding-dino-tiny with
    sam-vit-base (50 s on one CPU core for a crop, 3.4 GB), with random weights both. The published
    weights and CUDA have not been run; how good their masks are on driving logs is not measured.

    Source: Liu et al., Grounding DINO, 2023; Kirillov et al., Segment Anything, 2023.

    Args:
        folder: holds `grounding-dino` (IDEA-Research/grounding-dino-tiny or -base) and `sam`
            (facebook/sam-vit-base, -large or -huge), each as its Hugging Face repository:
            config.json, model.safetensors, preprocessor_config.json and, of the first, the
            tokenizer's files. Nothing is downloaded, no pickle is read, torchvision is not needed.
        rule: rule that says which detection is the logged vehicle.
        device: torch device; None is CUDA where there is one, else the CPU.

    Raises:
        InputError: a folder or file is missing, of another network or incomplete.
    """

    def __init__(
        self,
        folder: str | Path,
        rule: DetectionRule | None = None,
        device: str | None = None,
    ) -> None:
        folder = Path(folder)
        if not folder.is_dir():
            raise InputError(
                folder,
                "folder",
                "is missing",
                f"give a folder that holds {DETECTOR_FOLDER} and {SAM_FOLDER}",
            )
        self.rule = rule or DetectionRule()
        self.device = device or ("cuda" if torch.cuda.is_available() else "cpu")
        self.detector = PretrainedFolder(
            folder / DETECTOR_FOLDER,
            "grounding-dino",
            "GroundingDinoForObjectDetection",
            "GroundingDinoProcessor",
            "IDEA-Research/grounding-dino-base (or IDEA-Research/grounding-dino-tiny)",
            text=True,
        )
        self.sam = PretrainedFolder(
            folder / SAM_FOLDER,
            "sam",
            "SamModel",
            "SamProcessor",
            "facebook/sam-vit-huge (or facebook/sam-vit-large, facebook/sam-vit-base)",
        )
        for part in (self.detector, self.sam):
            part.check()

    def segment(self, target: SegmentationTarget) -> Segmentation:
        """See `Segmenter.segment`; the same crop always gives the same mask on the same device.
        Raises InputError: see the class; or SAM found nothing at all in the box."""
        text = text_prompt(target.category)
        prompt = choose_box(
            self.detect(target.image, text), logged_rectangle(target), self.rule, text
        )
        masks, predicted = self.propose(target.image, prompt.box)
        if not masks.any():
            raise InputError(
                self.sam.path,
                "mask",
                "is empty for this crop",
                "use the view of another camera, or `segmenter` box-lidar",
            )
        best = choose_mask(masks, predicted, target, prompt.box)
        doubts = [] if prompt.detected else [f"the logged box was used instead: {prompt.reason}"]
        if predicted[best] < _SURE:
            doubts.append(f"SAM predicts an overlap of only {predicted[best]:.2f} for its mask")
        return Segmentation(
            alpha=feather(large_pieces(masks[best], _SPECK)),
            notes=(
                f"box from {'the detector' if prompt.detected else 'the log'}: {prompt.reason}",
                f"mask {best + 1} of {len(masks)}: predicted overlap {predicted[best]:.2f}, "
                f"agreement with box and LiDAR "
                f"{agreement(masks[best], target, prompt.box):.2f}",
            ),
            doubts=tuple(doubts),
        )

    def detect(self, image: NDArray[np.uint8], text: str) -> tuple[Detection, ...]:
        """What Grounding DINO finds in an image (H, W, 3), with at least the rule's score."""
        processor, model = self._detector
        inputs = processor(images=image, text=text, return_tensors="pt").to(self.device)
        with torch.inference_mode():
            outputs = model(**inputs)
        found = processor.post_process_grounded_object_detection(
            outputs,
            inputs["input_ids"],
            threshold=self.rule.score,
            text_threshold=self.rule.score,
            target_sizes=[image.shape[:2]],
        )[0]
        if len(found["scores"]) == 0:  # its labels of nothing are not an empty list
            return ()
        scores, rectangles = (found[name].cpu().double().numpy() for name in ("scores", "boxes"))
        limits = np.array(image.shape[1::-1] * 2, np.float64)
        return tuple(
            Detection(np.clip(box, 0, limits), float(score), label)
            for box, score, label in zip(rectangles, scores, found["text_labels"], strict=True)
        )

    def propose(self, image: NDArray[np.uint8], box: Array) -> tuple[Mask, Array]:
        """SAM's masks (M, H, W) for a box (4,), and the overlap (M,) it predicts for each."""
        processor, model = self._sam
        inputs = processor(images=image, input_boxes=[[box.tolist()]], return_tensors="pt")
        with torch.inference_mode():
            outputs = model(
                pixel_values=inputs["pixel_values"].to(self.device),
                input_boxes=inputs["input_boxes"].to(self.device, torch.float32),
                multimask_output=True,
            )
        masks = processor.post_process_masks(
            outputs.pred_masks.cpu(), inputs["original_sizes"], inputs["reshaped_input_sizes"]
        )[0][0]
        predicted = np.clip(outputs.iou_scores[0, 0].cpu().double().numpy(), 0, 1)
        return np.asarray(masks.numpy(), np.bool_), predicted

    @cached_property
    def _detector(self) -> tuple[Any, Any]:
        return self.detector.read(self.device)

    @cached_property
    def _sam(self) -> tuple[Any, Any]:
        return self.sam.read(self.device)


def choose_mask(masks: Mask, predicted: Array, target: SegmentationTarget, box: Array) -> int:
    """Index of the best of masks (M, H, W): predicted overlap plus `agreement`, empty ones last.

    Args:
        predicted: (M,) overlap with the true mask as the network expects it, 0 to 1.
        box: (4,) box that the masks were prompted with, pixels.
    """
    scores = [
        value + agreement(mask, target, box) if mask.any() else -1.0
        for mask, value in zip(masks, predicted, strict=True)
    ]
    return int(np.argmax(scores))


def agreement(mask: Mask, target: SegmentationTarget, box: Array) -> float:
    """How well a mask (H, W) goes with box and LiDAR, 0 to 1.

    Mean of: overlap of the rectangle around the mask with the box (4,), which a door or a window
    alone does not reach; share of the vehicle's LiDAR points in the mask; share of the background's
    points outside it. What no LiDAR point tells is left out.
    """
    around = mask_rectangle(mask)
    if around is None:
        return 0.0
    on_object, on_other = lidar_shares(target, mask)
    terms = np.array([rectangle_overlap(around, box), on_object, 1.0 - on_other])
    return float(np.nanmean(terms))


def segmenter_of(segmenter: str | Path | Segmenter) -> Segmenter:
    """A segmenter by its name, Grounding DINO with SAM from a folder, or the object given.

    Args:
        segmenter: see `recast.core.plugins.Registry.resolve`. A name goes before a folder of the
            same name: write `./NAME` for that one.

    Raises:
        InputError: no such segmenter or folder, a folder without its networks, or an object that is
            not a segmenter.
    """
    return SEGMENTERS.resolve(segmenter)


def is_segmenter_folder(name_or_folder: str) -> bool:
    """Whether `segmenter_of` would read a folder."""
    return SEGMENTERS.place(name_or_folder) is not None
