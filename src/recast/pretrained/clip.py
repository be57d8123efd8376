"""The image side of CLIP (Radford et al. 2021)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from recast.pretrained.folder import PretrainedFolder, model_type


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
