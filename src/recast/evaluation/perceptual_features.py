"""CLIP image similarity and DINOv2 feature distance, through transformers from local folders."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.pretrained import ClipImages, PretrainedFolder, model_type, whole_picture

Array = NDArray[np.float64]


class FeatureDistance:
    """A number from the cosine between the features of two images, seen through a model.

    Args:
        key: of the score.
        features: from pixels (1, 3, S, S), normalised as the model wants them, to (1, C).
        processor: image processor of the model.
        of_cosine: from the cosine to the score.
    """

    framed = True

    def __init__(
        self,
        key: str,
        features: Callable[[Tensor], Tensor],
        processor: Any,
        of_cosine: Callable[[float], float],
    ) -> None:
        self.key = key
        self._features = features
        self._processor = processor
        self._of_cosine = of_cosine

    def __call__(self, image: Array, reference: Array) -> float:
        """Score of two images (H, W, 3) in [0, 1]."""
        return self._of_cosine(cosine(self.features(image), self.features(reference)))

    def features(self, image: Array) -> Array:
        """(C,) what the model makes of an image (H, W, 3) in [0, 1]."""
        with torch.no_grad():
            features: Array = (
                self._features(whole_picture(self._processor, image)).double()[0].numpy()
            )
        return features


def cosine(first: Array, second: Array) -> float:
    """Of the angle between two features (C,); exactly 1 for equal ones."""
    apart = _unit(first) - _unit(second)
    return 1.0 - 0.5 * float(apart @ apart)


def _unit(features: Array) -> Array:
    unit: Array = features / max(float(np.linalg.norm(features)), 1e-12)
    return unit


def load_clip(folder: Path) -> FeatureDistance:
    """CLIP image similarity: 100 times the cosine between image embeddings.

    Args:
        folder: of a CLIP model, both towers or the vision tower with its projection, in the files
            of its Hugging Face repository.

    Raises:
        InputError: see `PretrainedFolder.read`.
    """
    clip = ClipImages.read(folder)
    return FeatureDistance("clip", clip.embedding, clip.processor, lambda cosine: 100.0 * cosine)


def load_dino(folder: Path) -> FeatureDistance:
    """DINOv2 feature distance: 1 minus the cosine between class tokens after the final norm.

    Args:
        folder: of a DINOv2 model, with or without registers, in the files of its Hugging Face
            repository.

    Raises:
        InputError: see `PretrainedFolder.read`.
    """
    registers = model_type(folder) == "dinov2_with_registers"
    published = PretrainedFolder(
        folder, "dinov2_with_registers" if registers else "dinov2",
        "Dinov2WithRegistersModel" if registers else "Dinov2Model", "AutoImageProcessor",
        "facebook/dinov2-large or another DINOv2",
    )  # fmt: skip
    processor, model = published.read("cpu")

    def class_token(pixels: Tensor) -> Tensor:
        token: Tensor = model(pixel_values=pixels).last_hidden_state[:, 0]
        return token

    return FeatureDistance("dino", class_token, processor, lambda cosine: 1.0 - cosine)
