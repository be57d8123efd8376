"""Images as trained networks see them: distances of two, and features of vehicles' pictures.

Weights come from files that the user names. LPIPS (Zhang et al. 2018), the distance of deep
features weighted by what people see, is written out here. Its convolutions take published ImageNet
weights in torchvision's layout (`features.N.weight`), of AlexNet or VGG-16; the linear heads,
version 0.1 of LPIPS, lie beside this module (lpips_heads.md says where they come from).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import cv2
import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.torch_file import checked_weight, read_safetensors, read_tensors
from recast.geometry.colour import LUMINANCE
from recast.metrics.frechet import load_inception
from recast.pretrained import (
    ClipImages,
    Picture,
    PretrainedFolder,
    in_batches,
    model_type,
    resized,
    whole_picture,
)

if TYPE_CHECKING:
    from recast.metrics.actor_scores import ScoredCutout

SIDE, BATCH = 256, 16
"""Size of the pictures that `Lpips.distances` compares, and how many it looks at together."""
# Mean and deviation of the inputs, which are in [-1, 1] (the published LPIPS scaling layer).
_SHIFT = (-0.030, -0.088, -0.188)
_SCALE = (0.458, 0.448, 0.450)
_EPSILON = 1e-10
_HEADS = Path(__file__).with_name("lpips_heads.safetensors")
_MEND = "give AlexNet or VGG-16 weights as torchvision saves them, .pth or .safetensors"


class ImageDistance(Protocol):
    """A measure of two images of one size.

    Attributes:
        key: key of the score, see `ACTOR_COLUMNS`.
        framed: whether the measure looks at the square around the vehicle instead of the whole
            image.
    """

    key: str
    framed: bool

    def __call__(self, image: Array, reference: Array) -> float:
        """The score of two images (H, W, 3) with display values in [0, 1]."""


def load_distances(
    lpips: Path | None = None, clip: Path | None = None, dino: Path | None = None
) -> tuple[ImageDistance, ...]:
    """The measures for which weights are given.

    Args:
        lpips: weights file of the backbone, see `load_lpips`.
        clip: folder of a CLIP model.
        dino: folder of a DINOv2 model, with or without registers.

    Raises:
        InputError: what is named is missing or something else.
    """
    found: list[ImageDistance] = []
    if lpips is not None:
        found.append(load_lpips(lpips))
    if clip is not None or dino is not None:  # transformers takes seconds to import
        found += [load_clip(clip)] if clip is not None else []
        found += [load_dino(dino)] if dino is not None else []
    return tuple(found)


@dataclass(frozen=True)
class Convolution:
    """One convolution with rectifier.

    Attributes:
        index: N in `features.N.weight`.
        channels: numbers of channels in and out.
        kernel, stride, padding: pixels.
        pool: kernel of the max pooling (stride 2) before it; 0 for none.
        tapped: whether its output is compared.
    """

    index: int
    channels: tuple[int, int]
    kernel: int = 3
    stride: int = 1
    padding: int = 1
    pool: int = 0
    tapped: bool = True


def _vgg16() -> tuple[Convolution, ...]:
    layers, index, before = [], 0, 3
    for block, (width, depth) in enumerate(((64, 2), (128, 2), (256, 3), (512, 3), (512, 3))):
        for step in range(depth):
            pool = 2 if block and step == 0 else 0
            layers.append(Convolution(index, (before, width), pool=pool, tapped=step == depth - 1))
            before, index = width, index + 2
        index += 1  # the pooling's own number
    return tuple(layers)


BACKBONES: Mapping[str, tuple[Convolution, ...]] = {
    "alex": (
        Convolution(0, (3, 64), kernel=11, stride=4, padding=2),
        Convolution(3, (64, 192), kernel=5, padding=2, pool=3),
        Convolution(6, (192, 384), pool=3),
        Convolution(8, (384, 256)),
        Convolution(10, (256, 256)),
    ),
    "vgg": _vgg16(),
}
"""Networks by name; the names of their heads begin with it."""


class Lpips:
    """The distance; 0 for equal images.

    Args:
        backbone: key of `BACKBONES`.
        weights: `features.N.weight` and `features.N.bias` of its convolutions.
        heads: (C,) non-negative weights of every tapped layer's channels.
    """

    key = "lpips"
    framed = False

    def __init__(
        self, backbone: str, weights: Mapping[str, Tensor], heads: Sequence[Tensor]
    ) -> None:
        self.backbone = backbone
        self._layers = BACKBONES[backbone]
        self._weights = weights
        self._heads = heads

    def to(self, device: str) -> Lpips:
        """The same on a torch device."""
        weights = {name: tensor.to(device) for name, tensor in self._weights.items()}
        return Lpips(self.backbone, weights, [head.to(device) for head in self._heads])

    def __call__(self, image: Array, reference: Array) -> float:
        """Distance of two images (H, W, 3) in [0, 1], at least 32 pixels wide and high.

        sum over tapped layers of the mean over pixels of w . (unit(x) - unit(y))^2, with features
        of unit length at every pixel (Zhang et al. 2018, eq. 1).

        Raises:
            ValueError: an image is smaller than the network can take.
        """
        if min(image.shape[:2]) < 32:
            raise ValueError(
                f"Lpips: image of {image.shape[1]}x{image.shape[0]}, expected 32x32 or larger"
            )
        with torch.no_grad():
            first, second = (self._unit(_pixels(one)) for one in (image, reference))
            return float(self._distance(first, second))

    def distances(
        self, pictures: Sequence[Picture], references: Sequence[Picture], batch: int = BATCH
    ) -> Array:
        """(N, M) distance of each of N pictures to each of M references.

        Pictures of any sizes are brought to 256 x 256 (bilinear, antialiased, the ratio of sides
        lost). Features of all references are held at once: 2.6 MB each with AlexNet, 33 MB with
        VGG-16.

        Args:
            batch: pictures at a time; see `in_batches`.
        """

        if not references:
            return np.empty((len(pictures), 0))

        def unit(some: Sequence[Picture]) -> list[Tensor]:
            return self._unit(resized(some, SIDE, antialias=True))

        with torch.no_grad():
            known = [unit([one]) for one in references]

        def row(some: Sequence[Picture]) -> Tensor:
            seen = unit(some)
            return torch.stack([self._distance(seen, other) for other in known], dim=1)

        return in_batches(row, pictures, len(references), batch)

    def features(self, image: Array) -> list[Tensor]:
        """Outputs (C, h, w) of the tapped layers."""
        return [tap[0] for tap in self._taps(_pixels(image))]

    def _unit(self, pixels: Tensor) -> list[Tensor]:
        """Outputs (N, C, h, w) of the tapped layers, of unit length at every pixel."""
        return [tap / (tap.norm(dim=1, keepdim=True) + _EPSILON) for tap in self._taps(pixels)]

    def _distance(self, first: Sequence[Tensor], second: Sequence[Tensor]) -> Tensor:
        """(N,) distances of features as `_unit` gives them; those of one picture meet all."""
        found = torch.zeros(len(first[0]), dtype=torch.float64, device=first[0].device)
        for x, y, head in zip(first, second, self._heads, strict=True):
            found += torch.einsum("c,nchw->nhw", head, (x - y).square()).double().mean(dim=(1, 2))
        return found

    def _taps(self, pixels: Tensor) -> list[Tensor]:
        """Outputs (N, C, h, w) of the tapped layers for (N, 3, H, W) in [0, 1]."""
        head = self._heads[0]
        shift, scale = (head.new_tensor(v)[:, None, None] for v in (_SHIFT, _SCALE))
        x = (pixels.to(head.device) * 2 - 1 - shift) / scale
        tapped = []
        for layer in self._layers:
            if layer.pool:
                x = functional.max_pool2d(x, layer.pool, stride=2)
            name = f"features.{layer.index}"
            x = functional.conv2d(
                x,
                self._weights[f"{name}.weight"],
                self._weights[f"{name}.bias"],
                stride=layer.stride,
                padding=layer.padding,
            ).relu()
            if layer.tapped:
                tapped.append(x)
        return tapped


def _pixels(image: Array) -> Tensor:
    """(1, 3, H, W) of an image (H, W, 3)."""
    return torch.from_numpy(np.ascontiguousarray(image, np.float32)).movedim(-1, 0)[None]


def load_lpips(path: Path) -> Lpips:
    """Read backbone weights, which tell by their shapes which network they are of.

    Raises:
        InputError: the file is missing, unreadable, of another network, or has a value that is not
            finite.
    """
    state = read_tensors(path, "LPIPS weights", _MEND)
    first = state.get("features.0.weight")
    kernel = first.shape[-1] if first is not None and first.ndim == 4 else None
    backbone = {11: "alex", 3: "vgg"}.get(kernel or 0)
    if backbone is None:
        raise InputError(path, "features.0.weight", "is not from a known network", _MEND)
    weights = {}
    for layer in BACKBONES[backbone]:
        before, after = layer.channels
        shapes = {"weight": (after, before, layer.kernel, layer.kernel), "bias": (after,)}
        for part, shape in shapes.items():
            name = f"features.{layer.index}.{part}"
            weights[name] = checked_weight(state, name, shape, path, _MEND)
    return Lpips(backbone, weights, _heads(backbone))


def _heads(backbone: str) -> list[Tensor]:
    """(C,) of every tapped layer."""
    heads, _ = read_safetensors(_HEADS, "LPIPS heads", "install recast again")
    return [heads[name] for name in sorted(heads) if name.startswith(f"{backbone}.")]


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
    """Cosine of the angle between two features (C,); exactly 1 for equal ones."""
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
