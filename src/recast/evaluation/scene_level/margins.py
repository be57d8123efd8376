"""Margins between what prompts claim of a picture, and cosines of crops (paper, table 2).

The prompts are the paper's. It does not say how scores of several prompts are joined: here each
list is averaged. Cosines are raw, without CLIP's logit scale.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_PREFIX = "A driving-camera image with"
POSITIVE = (
    f"{_PREFIX} realistic vehicles",
    f"{_PREFIX} complete and recognizable vehicles",
    f"{_PREFIX} vehicles that have normal shapes and intact geometry",
)
NEGATIVE = (
    f"{_PREFIX} unrealistic vehicles",
    f"{_PREFIX} incomplete or unrecognizable vehicles",
    f"{_PREFIX} vehicles that have distorted shapes or fragmented geometry",
)
VEHICLE = "vehicle"
SHOWN = 1000.0
"""Factor of both margins in tables."""


def clip_margin(frames: Array, positive: Array, negative: Array) -> Array:
    """(N,) mean cosine with the positive prompts less that with the negative ones.

    Args:
        frames: (N, D) embeddings of whole frames, of unit length as those below.
        positive, negative: (P, D) and (Q, D) embeddings of prompts.
    """
    return vqa_margin(frames @ positive.T, frames @ negative.T)


def vqa_margin(positive: Array, negative: Array) -> Array:
    """(N,) mean score of the positive prompts less that of the negative ones.

    Args:
        positive, negative: (N, P) and (N, Q) scores of whole frames, see `recast.pretrained.vqa`.
    """
    margin: Array = positive.mean(axis=1) - negative.mean(axis=1)
    return margin


def clip_text_score(crops: Array, text: Array) -> Array:
    """(N,) 100 times the cosine of crops (N, D) with a text (D,), all of unit length."""
    score: Array = 100.0 * (crops @ text)
    return score


def clip_image_score(crops: Array, references: Array) -> tuple[Array, Array]:
    """Mean (N,) and maximum (N,) over references of 100 times the cosine.

    Args:
        crops: (N, D), of unit length.
        references: (R, D) of one scene, at least one.
    """
    cosines = 100.0 * (crops @ references.T)
    return cosines.mean(axis=1), cosines.max(axis=1)
