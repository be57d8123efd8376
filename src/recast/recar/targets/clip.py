"""The image tower of CLIP, read through transformers from a folder of the user's."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from PIL import Image as PilImage
from torch import Tensor

from recast.errors import InputError
from recast.storage import read_json

CLIP_FILES = ("config.json", "model.safetensors", "preprocessor_config.json")
_MEND = "name a folder with the files of openai/clip-vit-large-patch14"


def check_clip(folder: Path, width: int) -> None:
    """Refuse a folder that holds no CLIP with image embeddings of `width` values.

    Raises:
        InputError: a file is missing, or of another network.
    """
    for name in CLIP_FILES:
        if not (folder / name).is_file():
            raise InputError(folder, name, "is missing", _MEND)
    config = read_json(folder / "config.json")
    kind = config.get("model_type") if isinstance(config, dict) else None
    if kind not in ("clip", "clip_vision_model"):
        raise InputError(folder / "config.json", "model_type", f"is {kind!r}, not 'clip'", _MEND)
    inner = config.get("vision_config", {}) if kind == "clip" else config
    found = config.get("projection_dim", inner.get("projection_dim"))
    if found != width:
        raise InputError(
            folder / "config.json", "projection_dim", f"is {found}, the predictor wants {width}",
            _MEND,
        )  # fmt: skip


def load_clip_embedding(folder: Path, width: int) -> Callable[[list[PilImage.Image]], Tensor]:
    """From pictures to image embeddings (N, width), not normalised.

    Raises:
        InputError: see `check_clip`; or tensors are missing.
    """
    check_clip(folder, width)
    from safetensors import SafetensorError
    from transformers import CLIPImageProcessor, CLIPVisionModelWithProjection

    try:
        processor = CLIPImageProcessor.from_pretrained(folder, local_files_only=True)
        loaded: Any = CLIPVisionModelWithProjection.from_pretrained(
            folder, local_files_only=True, use_safetensors=True, output_loading_info=True
        )
    except (OSError, ValueError, RuntimeError, SafetensorError) as error:
        first = str(error).strip().splitlines()[0]
        raise InputError(folder, "CLIP", f"cannot be read ({first[:80]})", _MEND) from None
    model, report = loaded
    if missing := sorted(report["missing_keys"]):
        raise InputError(folder / "model.safetensors", missing[0], "is missing", _MEND)
    model = model.float().eval()

    def embedding(pictures: list[PilImage.Image]) -> Tensor:
        pixels = processor(images=pictures, return_tensors="pt")["pixel_values"]
        with torch.no_grad():
            found: Tensor = model(pixel_values=pixels.float()).image_embeds
        return found

    return embedding
