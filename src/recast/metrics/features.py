"""Features of networks, by which pictures of vehicles are compared alone and as wholes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
import torch
from torch import Tensor

from recast.arrays import Array
from recast.geometry.colour import LUMINANCE
from recast.metrics.actor_scores import ScoredCutout
from recast.metrics.inception import load_inception
from recast.pretrained import ClipImages, PretrainedFolder, model_type, whole_picture

TOY_DIMENSIONS = 128
_SIDE, _CELLS, _ORIENTATIONS = 64, 4, 4
_GREY = 0.5  # behind the vehicle, so that dark and bright ones have an outline
_EDGE_GAIN = 4.0  # brings the spread of edges to that of colours


class FeatureDistance:
    """A number from the cosine between the features of two images, seen through a model.

    Args:
        key: key of `FEATURE_KINDS`.
        features: function from pixels (1, 3, S, S), normalised as the model wants them, to features
            (1, C).
        processor: image processor of the model.
    """

    framed = True

    def __init__(self, key: str, features: Callable[[Tensor], Tensor], processor: Any) -> None:
        self.key, self._features, self._processor = key, features, processor

    def __call__(self, image: Array, reference: Array) -> float:
        """Score of two images (H, W, 3) in [0, 1]."""
        compare = FEATURE_KINDS[self.key].compare
        assert compare is not None
        return compare(self.features(image), self.features(reference))

    def features(self, image: Array) -> Array:
        """(C,) what the model makes of an image (H, W, 3) in [0, 1]."""
        with torch.no_grad():
            found = self._features(whole_picture(self._processor, image))
        return np.asarray(found[0], np.float64)


def cosine(first: Array, second: Array) -> float:
    """Of the angle between two features (C,); exactly 1 for equal ones."""
    apart = _unit(first) - _unit(second)
    return 1.0 - 0.5 * float(apart @ apart)


def _unit(features: Array) -> Array:
    return features / max(float(np.linalg.norm(features)), 1e-12)


def load_clip(folder: Path) -> FeatureDistance:
    """CLIP image similarity: 100 times the cosine between image embeddings.

    Args:
        folder: folder of a CLIP model, both towers or the vision tower with its projection, in the
            files of its Hugging Face repository.

    Raises:
        InputError: see `PretrainedFolder.read`.
    """
    clip = ClipImages.read(folder)
    return FeatureDistance("clip", clip.embedding, clip.processor)


def load_dino(folder: Path) -> FeatureDistance:
    """DINOv2 feature distance: 1 minus the cosine between class tokens after the final norm.

    Args:
        folder: folder of a DINOv2 model, with or without registers, in the files of its Hugging
            Face repository.

    Raises:
        InputError: see `PretrainedFolder.read`.
    """
    registers = model_type(folder) == "dinov2_with_registers"
    published = PretrainedFolder(
        folder,
        "dinov2_with_registers" if registers else "dinov2",
        "Dinov2WithRegistersModel" if registers else "Dinov2Model",
        "AutoImageProcessor",
        "facebook/dinov2-large or another DINOv2",
    )
    processor, model = published.read("cpu")

    def class_token(pixels: Tensor) -> Tensor:
        return model(pixel_values=pixels).last_hidden_state[:, 0]

    return FeatureDistance("dino", class_token, processor)


@dataclass(frozen=True)
class FeatureKind:
    """What is computed from features of one kind.

    Attributes:
        score: column of the comparison of two pictures, None where there is none.
        frechet: column of the Frechet distance, None where there is none.
        compare: function from the features (D,) of two pictures to the score.
    """

    score: str | None
    frechet: str | None
    compare: Callable[[Array, Array], float] | None


FEATURE_KINDS: Mapping[str, FeatureKind] = {
    "toy": FeatureKind("toy", "fd_toy", lambda a, b: float(np.sqrt(np.mean((a - b) ** 2)))),
    "clip": FeatureKind("clip", None, lambda first, second: 100.0 * cosine(first, second)),
    "dino": FeatureKind("dino", "fd_dino", lambda first, second: 1.0 - cosine(first, second)),
    "inception": FeatureKind(None, "fd_inception", None),
}
"""By key of an `Embedder`; the scores of CLIP and DINOv2 are those of `recast eval actor`."""


class Embedder(Protocol):
    """Features of a picture.

    Attributes:
        key: key of `FEATURE_KINDS`.
    """

    key: str

    def features(self, cutout: ScoredCutout) -> Array:
        """(D,) of a square cutout, the vehicle whole in it."""


class ToyFeatures:
    """A handcrafted stand-in for features of networks, where no weights are given.

    The square is brought to 64 x 64 pixels and divided into 4 x 4 cells. Of each cell: the means of
    red, green, blue (multiplied by alpha) and alpha, and a histogram of the gradients of luma
    before mid grey over four unsigned orientations, magnitudes shared linearly between neighbours,
    mean over the cell, times four (after Dalal and Triggs 2005, without block normalisation). 128
    numbers. The distance of two pictures is the root of the mean squared difference. It tells
    colour and layout, not realism: no figure in it compares with one by Inception or DINOv2.
    """

    key = "toy"

    def features(self, cutout: ScoredCutout) -> Array:
        """(128,) of a square cutout."""
        image = np.dstack([cutout.rgb, cutout.alpha])
        way = cv2.INTER_AREA if len(image) > _SIDE else cv2.INTER_LINEAR
        small = np.asarray(cv2.resize(image, (_SIDE, _SIDE), interpolation=way), np.float64)
        luma = (small[..., :3] + (1 - small[..., 3:]) * _GREY) @ LUMINANCE
        vertical, horizontal = np.gradient(luma)
        where = np.arctan2(vertical, horizontal) / np.pi * _ORIENTATIONS
        bins = np.arange(_ORIENTATIONS)
        apart = np.abs((where[..., None] - bins + _ORIENTATIONS / 2) % _ORIENTATIONS)
        share = np.clip(1 - np.abs(apart - _ORIENTATIONS / 2), 0, None)
        edges = _EDGE_GAIN * np.hypot(vertical, horizontal)[..., None] * share
        cell = _SIDE // _CELLS
        cells = np.concatenate([small, edges], axis=2).reshape(_CELLS, cell, _CELLS, cell, -1)
        return cells.mean(axis=(1, 3)).reshape(-1)


class NetworkFeatures:
    """Features of a network that looks at the vehicle before black.

    Args:
        key: key of `FEATURE_KINDS`.
        embed: function from an image (H, W, 3) in [0, 1] to features (D,).
    """

    def __init__(self, key: str, embed: Callable[[Array], Array]) -> None:
        self.key = key
        self._embed = embed

    def features(self, cutout: ScoredCutout) -> Array:
        """(D,) of a square cutout."""
        return self._embed(cutout.rgb)


def load_embedders(
    clip: Path | None = None, dino: Path | None = None, inception: Path | None = None
) -> tuple[Embedder, ...]:
    """The stand-in, and the networks for which weights are given.

    Args:
        clip: folder of a CLIP model.
        dino: folder of a DINOv2 model, with or without registers.
        inception: weights file, see `load_inception`.

    Raises:
        InputError: what is named is missing or something else.
    """
    found: list[Embedder] = [ToyFeatures()]
    if clip is not None:
        found.append(NetworkFeatures("clip", load_clip(clip).features))
    if dino is not None:
        found.append(NetworkFeatures("dino", load_dino(dino).features))
    if inception is not None:
        found.append(NetworkFeatures("inception", load_inception(inception).features))
    return tuple(found)
