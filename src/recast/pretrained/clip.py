"""CLIP (Radford et al. 2021): embeddings of images and of texts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.pretrained.batches import BATCH, in_batches
from recast.pretrained.folder import PretrainedFolder, model_type
from recast.pretrained.pictures import Fit, Picture, mean_colour, network_input

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ClipImages:
    """CLIP's embedding of images.

    Attributes:
        processor: of transformers, from pictures to what the network takes.
        model: both towers, or the vision tower with its projection.
    """

    processor: Any
    model: Any

    @staticmethod
    def folder(path: Path) -> PretrainedFolder:
        """The folder of such a network, which its config.json says the kind of."""
        whole = model_type(path) != "clip_vision_model"
        return PretrainedFolder(
            path, "clip" if whole else "clip_vision_model",
            "CLIPModel" if whole else "CLIPVisionModelWithProjection", "CLIPImageProcessor",
            "openai/clip-vit-large-patch14 or another CLIP",
        )  # fmt: skip

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
        tokenizer: of transformers.
        device: torch device of the network.
    """

    vision: ClipImages
    tokenizer: Any
    device: str

    @staticmethod
    def folder(path: Path) -> PretrainedFolder:
        """The folder of such a network: both towers and the tokenizer's files."""
        return PretrainedFolder(
            path, "clip", "CLIPModel", "CLIPProcessor",
            "openai/clip-vit-large-patch14 (or openai/clip-vit-base-patch32)", text=True,
        )  # fmt: skip

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
            found: Tensor = model.text_projection(model.text_model(**read).pooler_output)
            return found

        return _scaled(in_batches(embedded, texts, self.width, batch), unit)


def _scaled(embeddings: Array, unit: bool) -> Array:
    if not unit:
        return embeddings
    lengths = np.linalg.norm(embeddings, axis=1, keepdims=True)
    scaled: Array = embeddings / np.maximum(lengths, 1e-12)
    return scaled
