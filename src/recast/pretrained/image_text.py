"""Pictures compared with texts: CLIP (Radford et al. 2021), VQAScore (Lin et al. 2024)."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.plugins import Registry
from recast.pretrained.folder import (
    BATCH,
    Fit,
    Picture,
    PretrainedFolder,
    in_batches,
    mean_colour,
    model_type,
    network_input,
)


@dataclass(frozen=True)
class ClipImages:
    """CLIP's embedding of images.

    Attributes:
        processor: image processor of transformers, from pictures to what the network takes.
        model: both towers, or the vision tower with its projection.
    """

    processor: Any
    model: Any

    @staticmethod
    def folder(path: Path) -> PretrainedFolder:
        """The folder of such a network, which its config.json says the kind of."""
        whole = model_type(path) != "clip_vision_model"
        return PretrainedFolder(
            path,
            "clip" if whole else "clip_vision_model",
            "CLIPModel" if whole else "CLIPVisionModelWithProjection",
            "CLIPImageProcessor",
            "openai/clip-vit-large-patch14 or another CLIP",
        )

    @classmethod
    def read(cls, path: Path) -> ClipImages:
        """Read a network onto the CPU.

        Raises:
            InputError: see `PretrainedFolder.read`.
        """
        return cls(*cls.folder(path).read("cpu"))

    @torch.no_grad()
    def embedding(self, pixels: Tensor) -> Tensor:
        """(N, D) embeddings, not normalised, of what the processor made of N pictures."""
        if hasattr(self.model, "visual_projection") and hasattr(self.model, "text_model"):
            tower = self.model.vision_model(pixel_values=pixels)
            found: Tensor = self.model.visual_projection(tower.pooler_output)
        else:
            found = self.model(pixel_values=pixels).image_embeds
        return found


@dataclass(frozen=True)
class Clip:
    """Both towers of CLIP: pictures and texts in one space.

    The embedding of an item does not depend on what is computed with it but for rounding: in
    float32 on the CPU, cosines with published sizes differ by less than 1e-5. See `in_batches` for
    what gives the same bytes.

    Attributes:
        vision: the network's image side.
        tokenizer: tokenizer of transformers.
        device: torch device of the network.
    """

    vision: ClipImages
    tokenizer: Any
    device: str

    @staticmethod
    def folder(path: Path) -> PretrainedFolder:
        """The folder of such a network: both towers and the tokenizer's files."""
        return PretrainedFolder(
            path,
            "clip",
            "CLIPModel",
            "CLIPProcessor",
            "openai/clip-vit-large-patch14 (or openai/clip-vit-base-patch32)",
            text=True,
        )

    @classmethod
    def read(cls, path: Path, device: str = "cpu") -> Clip:
        """Read a network in float32.

        Raises:
            InputError: see `PretrainedFolder.read`.
        """
        processor, model = cls.folder(path).read(device)
        return cls(ClipImages(processor.image_processor, model), processor.tokenizer, device)

    @property
    def width(self) -> int:
        """Length of an embedding, D."""
        return int(self.vision.model.config.projection_dim)

    @property
    def mean_colour(self) -> Picture:
        """(3,) colour for what a picture lacks."""
        return mean_colour(self.vision.processor)

    def images(
        self, pictures: Sequence[Picture], fit: Fit = "whole", unit: bool = True, batch: int = BATCH
    ) -> Array:
        """(N, D) embeddings of N pictures of any sizes.

        Args:
            fit: see `network_input`; `whole` is meant for squares.
            unit: whether they are scaled to length 1.
            batch: pictures at a time.
        """

        def embedded(some: Sequence[Picture]) -> Tensor:
            pixels = network_input(self.vision.processor, some, fit)
            return self.vision.embedding(pixels.to(self.device))

        return _scaled(in_batches(embedded, pictures, self.width, batch), unit)

    def texts(self, texts: Sequence[str], unit: bool = True, batch: int = BATCH) -> Array:
        """(N, D) embeddings of N texts, all of them filled up to the network's length.

        Raises:
            ValueError: a text is longer than the network reads (77 tokens with both end marks).
        """
        model = self.vision.model
        most = int(model.config.text_config.max_position_embeddings)

        def embedded(some: Sequence[str]) -> Tensor:
            tokens = self.tokenizer(list(some), padding="max_length", max_length=most)
            for text, ids in zip(some, tokens["input_ids"], strict=True):
                if len(ids) > most:
                    raise ValueError(f"Clip.texts: {text[:60]!r} has more than {most} tokens")
            read = {
                name: torch.tensor(tokens[name], device=self.device)
                for name in ("input_ids", "attention_mask")
            }
            return model.text_projection(model.text_model(**read).pooler_output)

        return _scaled(in_batches(embedded, texts, self.width, batch), unit)


def _scaled(embeddings: Array, unit: bool) -> Array:
    lengths = np.linalg.norm(embeddings, axis=1, keepdims=True)
    return embeddings / np.maximum(lengths, 1e-12) if unit else embeddings


class VqaScorer(Protocol):
    """A network that answers yes or no to a question about a picture.

    Scores of different networks do not compare, so that results name theirs.

    Attributes:
        name: name of the network, for results.
    """

    name: str

    def score(self, images: Sequence[Picture], texts: Sequence[str]) -> Array:
        """(N, M) in [0, 1]: how probable it is that image n, (H, W, 3) RGB, shows text m."""


VQA_SCORERS = Registry(
    "VQA scorer",
    "recast.vqa_scorers",
    members=("name", "score"),
    protocol="recast.pretrained.VqaScorer",
)
"""Each is a class or function that makes a `VqaScorer`; it may take the option `device`."""


def load_vqa_scorer(value: Any, device: str = "cpu", dtype: str | None = None) -> VqaScorer:
    """The scorer that a value stands for.

    Args:
        value: a folder of CLIP-FlanT5 (see `load_clip_t5`), `t2v_metrics:MODEL` (see `T2vMetrics`),
            a name of the entry-point group `recast.vqa_scorers`, "module:attribute", or a scorer.
        device, dtype: given to the code that makes the scorer, if it takes them.

    Raises:
        InputError: see `Registry.resolve`.
    """
    return VQA_SCORERS.resolve(value, device=device, dtype=dtype)


def checked_scores(scores: Any, images: int, texts: int, name: str) -> Array:
    """(images, texts) what a scorer returned, in float64.

    Raises:
        InputError: another shape, or a value outside of [0, 1].
    """
    found = np.asarray(scores, np.float64)
    if found.shape != (images, texts):
        problem = f"have shape {found.shape}, not {(images, texts)}"
    elif not np.all((found >= 0) & (found <= 1)):
        problem = "are not all in [0, 1]"
    else:
        return found
    raise InputError(
        name, "scores", problem, "return an array (images, texts) of values from 0 to 1"
    )


class T2vMetrics:
    """The scorers of the authors' package t2v_metrics, which the user installs.

    The package reads its weights from the cache of Hugging Face and downloads what is missing;
    HF_HUB_OFFLINE=1 forbids that. It takes files, so that pictures are written to a temporary
    folder, as PNG. What has been run: a stand-in with the interface of `t2v_metrics.VQAScore`.

    Args:
        model: one of its names.
        device: torch device.

    Raises:
        InputError: the package is not installed.
    """

    def __init__(self, model: str = "clip-flant5-xxl", device: str = "cuda") -> None:
        self.name = f"t2v_metrics:{model}"
        try:
            package = import_module("t2v_metrics")
        except ImportError as error:
            raise InputError(
                self.name,
                "package",
                f"cannot be imported ({error})",
                "pip install t2v-metrics, or give a folder of zhiqiulin/clip-flant5-xxl",
            ) from error
        self._score = package.VQAScore(model=model, device=device)

    def score(self, images: Sequence[Picture], texts: Sequence[str]) -> Array:
        """See `VqaScorer.score`.

        Raises:
            InputError: the package returns something else than such scores.
        """
        if not images or not texts:
            return np.empty((len(images), len(texts)))
        with tempfile.TemporaryDirectory(prefix="recast-vqa-") as folder:
            paths = [str(Path(folder) / f"{index}.png") for index in range(len(images))]
            for path, image in zip(paths, images, strict=True):
                Image.fromarray(image).save(path)
            scores = self._score(images=paths, texts=list(texts))
        return checked_scores(scores.detach().float().cpu(), len(images), len(texts), self.name)
