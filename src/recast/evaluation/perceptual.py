"""Distances of images by trained networks; their weights come from files that the user names."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class ImageDistance(Protocol):
    """A measure of two images of one size.

    Attributes:
        key: of the score, see `ACTOR_COLUMNS`.
        framed: whether it looks at the square around the vehicle instead of the whole image.
    """

    key: str
    framed: bool

    def __call__(self, image: Array, reference: Array) -> float:
        """The score of two images (H, W, 3) with display values in [0, 1]."""


def load_distances(
    lpips: Path | None = None, clip: Path | None = None, dino: Path | None = None
) -> tuple[ImageDistance, ...]:
    """The measures for which weights are given.

    Args:
        lpips: weights file of the backbone, see `perceptual_lpips.load_lpips`.
        clip: folder of a CLIP model.
        dino: folder of a DINOv2 model, with or without registers.

    Raises:
        InputError: what is named is missing or something else.
    """
    found: list[ImageDistance] = []
    if lpips is not None:
        from recast.evaluation.perceptual_lpips import load_lpips

        found.append(load_lpips(lpips))
    if clip is not None or dino is not None:  # transformers takes seconds to import
        from recast.evaluation.perceptual_features import load_clip, load_dino

        found += [load_clip(clip)] if clip is not None else []
        found += [load_dino(dino)] if dino is not None else []
    return tuple(found)
