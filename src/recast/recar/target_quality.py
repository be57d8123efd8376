"""Quality filter: its seam, agreement with the pictures, aesthetic predictor (Schuhmann 2022)."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image as PilImage
from scipy import ndimage
from torch import Tensor, nn

from recast.arrays import Image, Mask
from recast.core.errors import InputError
from recast.core.files import read_json
from recast.core.torch_file import read_tensors
from recast.pretrained import ClipImages
from recast.recar.target_cache import Target
from recast.recar.target_views import (
    TargetCutout,
    Viewpoint,
    closeness,
    framed,
    iou,
    of_picture,
    render,
    turned,
)
from recast.splats import Gaussians

PIXELS = 96
"""Side of the cut-outs that are compared."""

WEIGHTS = {
    "iou": 0.4,
    "psnr": 0.2,
    "symmetry": 0.1,
    "connected": 0.1,
    "solid": 0.1,
    "sharpness": 0.1,
}
"""Exponents of the parts; they add up to one."""

_LEAST_IOU = 0.5
_LEAST = 1e-3
_NEIGHBOURS = np.ones((3, 3, 3), bool)
WIDTHS = (768, 1024, 128, 64, 16, 1)
_DROPPED_AFTER = 3  # layers that a dropout follows in the published network; none is needed here

AZIMUTHS_DEG = (0.0, 90.0, 180.0, 270.0)
AESTHETIC_PIXELS = 512

_MEND = "name sac+logos+ava1-l14-linearMSE.pth of improved-aesthetic-predictor"

Embedding = Callable[[list[PilImage.Image]], Tensor]


@dataclass(frozen=True)
class TargetCandidate:
    """A target to judge.

    Attributes:
        gaussians: decoded Gaussians, in the unit cube.
        pictures: front, rear, left and right picture that it was made from; RGBA with straight
            alpha.
        viewpoints: viewpoints of these pictures, azimuth 0 ahead of the vehicle.
        heading_deg: direction of the vehicle's front in the frame of the target, 0 along +x.
    """

    target: Target
    gaussians: Gaussians
    pictures: Sequence[Image]
    viewpoints: Sequence[Viewpoint]
    heading_deg: float = 0.0


@dataclass(frozen=True)
class Quality:
    """What a score says; more is better.

    Attributes:
        flipped: score with front and rear exchanged; None where the score cannot tell.
        parts: what the score is made of, by name.
    """

    score: float
    flipped: float | None = None
    parts: Mapping[str, float] = field(default_factory=dict)


class QualityScore(Protocol):
    """A way to judge targets.

    Attributes:
        name: name under which scores are recorded.
        threshold: least score of a target that is used, where the user names none.
    """

    name: str
    threshold: float

    def __call__(self, candidate: TargetCandidate) -> Quality:
        """Judge a target; the same target gets the same score."""
        ...


class AgreementScore:
    """How well a target agrees with the pictures it was made from, and whether it is sound.

    The weighted geometric mean, in (0, 1], of parts in [0, 1]:

    - iou: of the silhouettes of picture and render, mean over the four views, 0.5 as 0: any two
      vehicles reach that. Both are cut out at one scale, so that the unknown size of the asset
      does not matter;
    - psnr: of the colours where either shows the vehicle, 5 dB as 0 and 25 dB as 1;
    - symmetry: share of voxels with a voxel within one of their mirror image about the middle
      plane between left and right;
    - connected: share of voxels in the largest connected part: the rest floats;
    - solid: area of the silhouettes over that with their holes filled;
    - sharpness: mean gradient of the renders over that of the pictures, at most 1.

    The target is judged as it looks along `TargetCandidate.heading_deg`. `flipped` is the same with
    front and rear exchanged: one that is higher tells of a vehicle that came out so. This is no
    measure of beauty and not comparable to the published predictor; the threshold is relative, a
    cut through the scores of one model.
    """

    name = "view-agreement"
    threshold = 0.6

    def __call__(self, candidate: TargetCandidate) -> Quality:
        """See the class."""
        pictures = [framed(of_picture(picture), PIXELS) for picture in candidate.pictures]
        parts = {
            "symmetry": mirror_symmetry(candidate.target.coords, candidate.heading_deg),
            "connected": largest_part(candidate.target.coords),
        }
        own = parts | _agreement(pictures, _renders(candidate, 0.0))
        exchanged = parts | _agreement(pictures, _renders(candidate, 180.0))
        shown = {name: round(value, 6) for name, value in own.items()}
        return Quality(_mean(own), _mean(exchanged), shown)


def _renders(candidate: TargetCandidate, turn_deg: float) -> list[TargetCutout]:
    made = []
    for view in candidate.viewpoints:
        seen_from = turned(view, candidate.heading_deg + turn_deg)
        whole = render(candidate.gaussians, seen_from, 2 * PIXELS)
        made.append(framed(whole, PIXELS))
    return made


def _mean(parts: dict[str, float]) -> float:
    """Weighted geometric mean: no part can make up for one that is nothing."""
    logs = [weight * np.log(max(parts[name], _LEAST)) for name, weight in WEIGHTS.items()]
    return round(float(np.exp(np.sum(logs))), 6)


def _agreement(
    pictures: Sequence[TargetCutout], renders: Sequence[TargetCutout]
) -> dict[str, float]:
    pairs = list(zip(pictures, renders, strict=True))
    overlap = float(np.mean([iou(first.mask, second.mask) for first, second in pairs]))
    return {
        "iou": max(0.0, (overlap - _LEAST_IOU) / (1 - _LEAST_IOU)),
        "psnr": float(np.mean([closeness(first, second) for first, second in pairs])),
        "solid": float(np.mean([_solidity(shown.mask) for shown in renders])),
        "sharpness": float(np.mean([_sharpness(first, second) for first, second in pairs])),
    }


def _solidity(mask: Mask) -> float:
    filled = np.count_nonzero(ndimage.binary_fill_holes(mask))
    return float(np.count_nonzero(mask) / filled) if filled else 0.0


def _sharpness(picture: TargetCutout, shown: TargetCutout) -> float:
    wanted, found = _gradient(picture), _gradient(shown)
    return min(1.0, found / wanted) if wanted > 0 else 1.0


def _gradient(cutout: TargetCutout) -> float:
    """Mean length of the grey values' gradient inside the silhouette, its border left out."""
    inside = ndimage.binary_erosion(cutout.mask, iterations=2)
    if not inside.any():
        return 0.0
    grey = cutout.rgb.mean(axis=2)
    across, down = cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)
    return float(np.hypot(across, down)[inside].mean())


def mirror_symmetry(coords: NDArray[np.int32], heading_deg: float = 0.0) -> float:
    """Share of voxels (T, 3) with a voxel within one of their image in the middle plane.

    The plane is upright, along the heading, through the voxels' mean.
    """
    # The mean, not the middle of the bounding box, which one floating voxel would move.
    angle = np.radians(heading_deg)
    left = np.array([-np.sin(angle), np.cos(angle), 0.0])
    aside = (coords - coords.mean(axis=0)) @ left
    mirrored = np.floor(coords - 2 * aside[:, None] * left + 0.5).astype(np.int32)
    low = np.minimum(coords.min(axis=0), mirrored.min(axis=0))
    shape = np.maximum(coords.max(axis=0), mirrored.max(axis=0)) - low + 1
    grid = np.zeros(shape, bool)
    grid[tuple((coords - low).T)] = True
    near = ndimage.binary_dilation(grid, _NEIGHBOURS)
    return float(near[tuple((mirrored - low).T)].mean())


def largest_part(coords: NDArray[np.int32]) -> float:
    """Share of voxels (T, 3) in the largest part connected by faces, edges or corners."""
    local = coords - coords.min(axis=0)
    grid = np.zeros(local.max(axis=0) + 1, bool)
    grid[tuple(local.T)] = True
    labels, _ = ndimage.label(grid, _NEIGHBOURS)
    sizes = np.bincount(labels.ravel())[1:]
    return float(sizes.max() / sizes.sum())


class AestheticScore:
    """Mean score of four renders, about 1 to 10; the paper keeps what is above 4.5.

    The renders are composed as in the pipeline whose targets are filtered: four views evenly
    around the asset at 15 degrees elevation, field of view 40 degrees from a distance of 2, 512
    pixels, on black (Xiang et al. 2024 average over four even views; elevation and background are
    those of its renderer, since the paper does not say). Each is embedded by CLIP ViT-L/14, the
    embedding made a unit vector, and read by a chain of linear layers 768-1024-128-64-16-1: the
    published one has dropouts between them, and no activations.

    Args:
        embedding: function from pictures to (N, 768) image embeddings of CLIP.
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
        check_clip(clip, WIDTHS[0])
        network = ClipImages.read(clip)

        def embedding(pictures: list[PilImage.Image]) -> Tensor:
            pixels = network.processor(images=pictures, return_tensors="pt")["pixel_values"]
            return network.embedding(pixels.float())

        return cls(embedding, load_predictor(predictor))

    def __call__(self, candidate: TargetCandidate) -> Quality:
        """See the class."""
        renders = [
            render(candidate.gaussians, Viewpoint(azimuth), AESTHETIC_PIXELS).before(0.0)
            for azimuth in AZIMUTHS_DEG
        ]
        scores = self.scores([PilImage.fromarray(picture) for picture in renders])
        parts = {f"view_{int(a)}": s for a, s in zip(AZIMUTHS_DEG, scores, strict=True)}
        return Quality(round(sum(scores) / len(scores), 4), None, parts)

    def scores(self, pictures: list[PilImage.Image]) -> list[float]:
        """Score of each picture."""
        with torch.no_grad():
            unit = nn.functional.normalize(self._embedding(pictures).float(), dim=-1)
            return [round(float(score), 4) for score in self._network(unit)[:, 0]]


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
        raise InputError(path, "aesthetic predictor", "does not hold the expected network", _MEND)
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
        problem = f"is {found}, the predictor needs {width}"
        mend = "give a folder with the files of openai/clip-vit-large-patch14"
        raise InputError(folder / "config.json", "projection_dim", problem, mend)


def file_hash(paths: Iterator[Path]) -> str:
    """SHA-256 of the contents of files, one after the other with their lengths before them."""
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.stat().st_size.to_bytes(8, "big"))
        with path.open("rb") as stream:
            while block := stream.read(1 << 22):
                digest.update(block)
    return digest.hexdigest()
