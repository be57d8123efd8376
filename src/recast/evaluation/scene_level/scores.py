"""Scores of single images, and the columns of the scene-level tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.evaluation.scene_level.features import Features
from recast.evaluation.scene_level.margins import (
    NEGATIVE,
    POSITIVE,
    SHOWN,
    clip_image_score,
    clip_margin,
    clip_text_score,
    vqa_margin,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ScoreColumn:
    """A column of the table.

    Attributes:
        heading: for people.
        digits: after the point.
        higher_is_better: or lower.
        features: name of the features of a Frechet distance; None for a mean of image scores.
    """

    heading: str
    digits: int
    higher_is_better: bool
    features: str | None = None


COLUMNS: Mapping[str, ScoreColumn] = {
    "fd_scene": ScoreColumn("scene FD", 2, False, "frame_inception"),
    "fd_scene_toy": ScoreColumn("scene FD, toy", 4, False, "frame_toy"),
    "clip_margin": ScoreColumn("CLIP margin x1000", 2, True),
    "clip_margin_padded": ScoreColumn("CLIP margin x1000, padded", 2, True),
    "vqa_margin": ScoreColumn("VQA margin x1000", 2, True),
    "fd_crop": ScoreColumn("crop FD", 2, False, "crop_inception"),
    "fd_crop_toy": ScoreColumn("crop FD, toy", 4, False, "crop_toy"),
    "clip_img": ScoreColumn("CLIP image", 2, True),
    "clip_img_max": ScoreColumn("CLIP image, nearest", 2, True),
    "clip_veh": ScoreColumn("CLIP vehicle", 2, True),
    "lpips": ScoreColumn("LPIPS", 4, False),
}
"""In the order of the paper's table 2; `toy` is a stand-in where no weights are given."""

IMAGE_SCORES = tuple(name for name, column in COLUMNS.items() if column.features is None)


def image_scores(features: Features, references: Features, compared: Array) -> dict[str, Array]:
    """Scores (N,) of the images of an arm in a scene, by column; those there are networks for.

    Args:
        features: features of the arm's images, see `recast.evaluation.scene_level.features`.
        references: features of the scene's logged images.
        compared: (K,) indices of the references that crops are compared with.
    """
    found: dict[str, Array] = {}
    count = len(POSITIVE)
    if "text_clip" in features:
        texts = np.asarray(features["text_clip"], np.float64)
        positive, negative, vehicle = texts[:count], texts[count:-1], texts[-1]
        for name, key in (
            ("clip_margin", "frame_clip"),
            ("clip_margin_padded", "frame_clip_padded"),
        ):
            found[name] = SHOWN * clip_margin(_array(features, key), positive, negative)
        crops = _array(features, "crop_clip")
        found["clip_veh"] = clip_text_score(crops, vehicle)
        likened = _array(references, "crop_clip")[compared]
        found["clip_img"], found["clip_img_max"] = clip_image_score(crops, likened)
    if "vqa" in features:
        answers = _array(features, "vqa")
        assert answers.shape[1] == count + len(NEGATIVE)
        found["vqa_margin"] = SHOWN * vqa_margin(answers[:, :count], answers[:, count:])
    if "lpips" in features:
        found["lpips"] = _array(features, "lpips")
    return {name: found[name] for name in IMAGE_SCORES if name in found}


def _array(features: Features, name: str) -> Array:
    return np.asarray(features[name], np.float64)
