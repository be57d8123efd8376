"""CLIP as the aesthetic predictor wants it: of one width, from a folder of the user's."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from PIL import Image as PilImage
from torch import Tensor

from recast.errors import InputError
from recast.pretrained import ClipImages
from recast.storage import read_json


def check_clip(folder: Path, width: int) -> None:
    """Refuse a folder that holds no CLIP with image embeddings of `width` values.

    Raises:
        InputError: a file is missing, or of another network.
    """
    ClipImages.folder(folder).check()
    config = read_json(folder / "config.json")
    inner = config.get("vision_config", {}) if config["model_type"] == "clip" else config
    found = config.get("projection_dim", inner.get("projection_dim"))
    if found != width:
        raise InputError(
            folder / "config.json", "projection_dim", f"is {found}, the predictor wants {width}",
            "name a folder with the files of openai/clip-vit-large-patch14",
        )  # fmt: skip


def load_clip_embedding(folder: Path, width: int) -> Callable[[list[PilImage.Image]], Tensor]:
    """From pictures to image embeddings (N, width), not normalised.

    Raises:
        InputError: see `check_clip` and `PretrainedFolder.read`.
    """
    check_clip(folder, width)
    clip = ClipImages.read(folder)

    def embedding(pictures: list[PilImage.Image]) -> Tensor:
        pixels = clip.processor(images=pictures, return_tensors="pt")["pixel_values"]
        return clip.embedding(pixels.float())

    return embedding
