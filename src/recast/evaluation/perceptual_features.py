"""CLIP image similarity and DINOv2 feature distance, through transformers from local folders."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image as PilImage
from torch import Tensor

from recast.errors import InputError

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
        first, second = self._unit(image), self._unit(reference)
        cosine = 1.0 - 0.5 * float((first - second).square().sum())  # exactly 1 for equal images
        return self._of_cosine(cosine)

    def _unit(self, image: Array) -> Tensor:
        picture = PilImage.fromarray(np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8))
        pixels = self._processor(images=picture, return_tensors="pt")["pixel_values"]
        with torch.no_grad():
            features = self._features(pixels.float()).double()[0]
        return features / features.norm().clamp_min(1e-12)


def load_clip(folder: Path) -> FeatureDistance:
    """CLIP image similarity: 100 times the cosine between image embeddings.

    Args:
        folder: of a CLIP model as transformers saves it, safetensors.

    Raises:
        InputError: the folder is missing, incomplete, or holds something else.
    """
    from transformers import CLIPImageProcessor, CLIPVisionModelWithProjection

    model, processor = _load(
        folder, "CLIP", ("clip", "clip_vision_model"), CLIPVisionModelWithProjection,
        CLIPImageProcessor,
    )  # fmt: skip
    return FeatureDistance(
        "clip", lambda pixels: model(pixel_values=pixels).image_embeds, processor,
        lambda cosine: 100.0 * cosine,
    )  # fmt: skip


def load_dino(folder: Path) -> FeatureDistance:
    """DINOv2 feature distance: 1 minus the cosine between class tokens after the final norm.

    Args:
        folder: of a DINOv2 model, with or without registers, as transformers saves it, safetensors.

    Raises:
        InputError: as `load_clip`.
    """
    from transformers import AutoImageProcessor, AutoModel

    model, processor = _load(
        folder, "DINOv2", ("dinov2", "dinov2_with_registers"), AutoModel, AutoImageProcessor
    )
    return FeatureDistance(
        "dino", lambda pixels: model(pixel_values=pixels).last_hidden_state[:, 0], processor,
        lambda cosine: 1.0 - cosine,
    )  # fmt: skip


def _load(
    folder: Path, name: str, kinds: tuple[str, ...], model_class: Any, processor_class: Any
) -> tuple[Any, Any]:
    """Model in evaluation mode and image processor; nothing is fetched, no pickle is read."""
    from transformers import AutoConfig

    mend = (
        f"give a folder with config.json, preprocessor_config.json and model.safetensors of {name}"
    )
    if not folder.is_dir():
        raise InputError(folder, f"{name} model", "is no folder", mend)
    for file in ("config.json", "preprocessor_config.json"):
        if not (folder / file).is_file():
            raise InputError(folder / file, f"{name} model", "is missing", mend)
    try:
        config = AutoConfig.from_pretrained(folder, local_files_only=True)
        if config.model_type not in kinds:
            raise InputError(
                folder / "config.json", "model_type", f"is {config.model_type!r}", mend
            )
        model, report = model_class.from_pretrained(
            folder, local_files_only=True, use_safetensors=True, output_loading_info=True,
            dtype=torch.float32,
        )  # fmt: skip
        processor = processor_class.from_pretrained(folder, local_files_only=True)
    except InputError:
        raise
    except Exception as error:  # transformers raises whatever the file provokes
        first_line = (str(error).strip().splitlines() or ["no reason given"])[0]
        raise InputError(
            folder, f"{name} model", f"cannot be loaded ({first_line})", mend
        ) from None
    missing = sorted(report["missing_keys"])
    if missing:
        raise InputError(
            folder, f"{name} model", f"lacks {len(missing)} tensors, first {missing[0]}", mend
        )
    return model.eval(), processor
