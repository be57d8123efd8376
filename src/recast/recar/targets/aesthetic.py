"""The Improved Aesthetic Predictor (Schuhmann 2022) on renders of targets, embedded by CLIP."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import torch
from PIL import Image as PilImage
from torch import Tensor, nn

from recast.core.errors import InputError
from recast.core.files import read_json
from recast.core.torch_file import read_tensors
from recast.pretrained import ClipImages
from recast.recar.targets.quality import Candidate, Quality
from recast.recar.targets.record import file_hash
from recast.recar.targets.views import Viewpoint, render
from recast.splats import Gaussians

WIDTHS = (768, 1024, 128, 64, 16, 1)
_DROPPED_AFTER = 3  # layers that a dropout follows in the published network; none is needed here

AZIMUTHS_DEG = (0.0, 90.0, 180.0, 270.0)
PIXELS = 512

_MEND = "name sac+logos+ava1-l14-linearMSE.pth of improved-aesthetic-predictor"

Embedding = Callable[[list[PilImage.Image]], Tensor]


class AestheticScore:
    """Mean score of four renders, about 1 to 10; the paper keeps what is above 4.5.

    The renders are composed as in the pipeline whose targets are filtered: four views evenly
    around the asset at 15 degrees elevation, field of view 40 degrees from a distance of 2, 512
    pixels, on black (Xiang et al. 2024 average over four even views; elevation and background are
    those of its renderer, since the paper does not say). Each is embedded by CLIP ViT-L/14, the
    embedding made a unit vector, and read by a chain of linear layers 768-1024-128-64-16-1: the
    published one has dropouts between them, and no activations.

    Args:
        embedding: from pictures to (N, 768) image embeddings of CLIP.
        network: the chain.
    """

    name = "improved-aesthetic-predictor"
    threshold = 4.5

    def __init__(self, embedding: Embedding, network: nn.Module) -> None:
        self._embedding = embedding
        self._network = network

    @classmethod
    def load(cls, predictor: Path, clip: Path) -> AestheticScore:
        """Read the weights.

        Args:
            predictor: a .pth file; only tensors are read from it, no code.
            clip: folder of CLIP ViT-L/14 in the files of its Hugging Face repository.

        Raises:
            InputError: a file is missing, or of another network.
        """
        return cls(load_clip_embedding(clip, WIDTHS[0]), load_predictor(predictor))

    def __call__(self, candidate: Candidate) -> Quality:
        """See the class."""
        scores = self.scores(aesthetic_renders(candidate.gaussians))
        parts = {f"view_{int(a)}": s for a, s in zip(AZIMUTHS_DEG, scores, strict=True)}
        return Quality(round(sum(scores) / len(scores), 4), None, parts)

    def scores(self, pictures: list[PilImage.Image]) -> list[float]:
        """Score of each picture."""
        with torch.no_grad():
            unit = nn.functional.normalize(self._embedding(pictures).float(), dim=-1)
            return [round(float(score), 4) for score in self._network(unit)[:, 0]]


def aesthetic_renders(gaussians: Gaussians) -> list[PilImage.Image]:
    """The pictures that are scored."""
    return [
        PilImage.fromarray(render(gaussians, Viewpoint(azimuth), PIXELS).before(0.0))
        for azimuth in AZIMUTHS_DEG
    ]


def load_predictor(path: Path) -> nn.Sequential:
    """The chain of linear layers, from a file of the published layout: layers.N.weight, .bias.

    Raises:
        InputError: the file is missing, broken, holds more than tensors, or another network.
    """
    found = read_tensors(path, "aesthetic predictor", _MEND)
    layers: dict[str, nn.Module] = {}
    position = 0
    for index, (width, out) in enumerate(pairwise(WIDTHS)):
        layers[str(position)] = nn.Linear(width, out)
        position += 2 if index < _DROPPED_AFTER else 1
    expected = {
        f"layers.{name}.{part}": tensor
        for name, layer in layers.items()
        for part, tensor in layer.state_dict().items()
    }
    if found.keys() != expected.keys():
        raise InputError(path, "aesthetic predictor", "is another network", _MEND)
    for name, tensor in expected.items():
        given = found[name]
        if given.shape != tensor.shape:
            raise InputError(path, name, f"is not of shape {tuple(tensor.shape)}", _MEND)
        if not bool(torch.isfinite(given).all()):
            raise InputError(path, name, "holds NaN or infinite values", _MEND)
        tensor.copy_(given)
    return nn.Sequential(*layers.values()).eval().requires_grad_(False)


def weight_hashes(predictor: Path, clip: Path) -> dict[str, str]:
    """SHA-256 of the weights, once they were looked at.

    Raises:
        InputError: as `AestheticScore.load`, as far as is quick.
    """
    load_predictor(predictor)
    check_clip(clip, WIDTHS[0])
    return {
        "predictor": file_hash(iter([predictor])),
        "clip": file_hash(iter(ClipImages.folder(clip).files())),
    }


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
            folder / "config.json",
            "projection_dim",
            f"is {found}, the predictor wants {width}",
            "name a folder with the files of openai/clip-vit-large-patch14",
        )


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
