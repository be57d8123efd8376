"""Inception v3 (Szegedy et al. 2016) up to its pooled features, as the FID looks through it.

Written out here; it takes the weights of the FID's network or of torchvision's ImageNet
classifier, both in torchvision's layout (`Mixed_5b.branch1x1.conv.weight`, ...). The FID's network
came from TensorFlow and differs in two poolings; it is told by its 1008 classes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
import torch.nn.functional as functional
from torch import Tensor

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.torch_file import checked_weight, read_tensors
from recast.pretrained import BATCH, Picture, in_batches, resized

Shape = tuple[int, int, int, int]
"""Channels in and out, kernel height and width."""

FEATURES = 2048
_SIDE = 299
_BN_EPSILON = 1e-3
_FID_CLASSES, _IMAGENET_CLASSES = 1008, 1000
_MEND = (
    "give pt_inception-2015-12-05 (the FID's network) or inception_v3_google of torchvision, "
    ".pth or .safetensors"
)


def _square(before: int, after: int, kernel: int = 1) -> Shape:
    return before, after, kernel, kernel


def _block_a(before: int, pool: int) -> dict[str, Shape]:
    return {
        "branch1x1": _square(before, 64),
        "branch5x5_1": _square(before, 48),
        "branch5x5_2": _square(48, 64, 5),
        "branch3x3dbl_1": _square(before, 64),
        "branch3x3dbl_2": _square(64, 96, 3),
        "branch3x3dbl_3": _square(96, 96, 3),
        "branch_pool": _square(before, pool),
    }


def _block_b() -> dict[str, Shape]:
    return {
        "branch3x3": _square(288, 384, 3),
        "branch3x3dbl_1": _square(288, 64),
        "branch3x3dbl_2": _square(64, 96, 3),
        "branch3x3dbl_3": _square(96, 96, 3),
    }


def _block_c(middle: int) -> dict[str, Shape]:
    return {
        "branch1x1": _square(768, 192),
        "branch7x7_1": _square(768, middle),
        "branch7x7_2": (middle, middle, 1, 7),
        "branch7x7_3": (middle, 192, 7, 1),
        "branch7x7dbl_1": _square(768, middle),
        "branch7x7dbl_2": (middle, middle, 7, 1),
        "branch7x7dbl_3": (middle, middle, 1, 7),
        "branch7x7dbl_4": (middle, middle, 7, 1),
        "branch7x7dbl_5": (middle, 192, 1, 7),
        "branch_pool": _square(768, 192),
    }


def _block_d() -> dict[str, Shape]:
    return {
        "branch3x3_1": _square(768, 192),
        "branch3x3_2": _square(192, 320, 3),
        "branch7x7x3_1": _square(768, 192),
        "branch7x7x3_2": (192, 192, 1, 7),
        "branch7x7x3_3": (192, 192, 7, 1),
        "branch7x7x3_4": _square(192, 192, 3),
    }


def _block_e(before: int) -> dict[str, Shape]:
    return {
        "branch1x1": _square(before, 320),
        "branch3x3_1": _square(before, 384),
        "branch3x3_2a": (384, 384, 1, 3),
        "branch3x3_2b": (384, 384, 3, 1),
        "branch3x3dbl_1": _square(before, 448),
        "branch3x3dbl_2": _square(448, 384, 3),
        "branch3x3dbl_3a": (384, 384, 1, 3),
        "branch3x3dbl_3b": (384, 384, 3, 1),
        "branch_pool": _square(before, 192),
    }


CONVOLUTIONS: Mapping[str, Shape] = {
    "Conv2d_1a_3x3": _square(3, 32, 3),
    "Conv2d_2a_3x3": _square(32, 32, 3),
    "Conv2d_2b_3x3": _square(32, 64, 3),
    "Conv2d_3b_1x1": _square(64, 80),
    "Conv2d_4a_3x3": _square(80, 192, 3),
} | {
    f"{block}.{branch}": shape
    for block, branches in {
        "Mixed_5b": _block_a(192, 32),
        "Mixed_5c": _block_a(256, 64),
        "Mixed_5d": _block_a(288, 64),
        "Mixed_6a": _block_b(),
        "Mixed_6b": _block_c(128),
        "Mixed_6c": _block_c(160),
        "Mixed_6d": _block_c(160),
        "Mixed_6e": _block_c(192),
        "Mixed_7a": _block_d(),
        "Mixed_7b": _block_e(1280),
        "Mixed_7c": _block_e(2048),
    }.items()
    for branch, shape in branches.items()
}
"""All convolutions of the trunk, each followed by batch normalisation and a rectifier."""


class Inception:
    """The network.

    Args:
        weights: kernel and offset of every convolution, batch normalisation folded in.
        fid: whether it is the FID's network.
    """

    def __init__(self, weights: Mapping[str, tuple[Tensor, Tensor]], fid: bool) -> None:
        self.fid = fid
        self._weights = weights

    def to(self, device: str) -> Inception:
        """The same on a torch device."""
        weights = {name: (k.to(device), o.to(device)) for name, (k, o) in self._weights.items()}
        return Inception(weights, self.fid)

    def features(self, image: Array) -> Array:
        """(2048,) of an image (H, W, 3) in [0, 1], brought to 299 x 299 bilinearly as the FID's."""
        return self.embeddings([image])[0]

    def embeddings(self, pictures: Sequence[Picture | Array], batch: int = BATCH) -> Array:
        """(N, 2048) of N pictures (H, W, 3) of any sizes, uint8 or in [0, 1]; see `features`.

        Args:
            batch: pictures at a time; see `in_batches`.
        """
        device = self._weights["Conv2d_1a_3x3"][0].device

        def pooled(some: Sequence[Picture | Array]) -> Tensor:
            return self._trunk(2 * resized(some, _SIDE).to(device) - 1).mean(dim=(2, 3))

        return in_batches(pooled, pictures, FEATURES, batch)

    def _trunk(self, x: Tensor) -> Tensor:
        x = self._conv("Conv2d_1a_3x3", x, stride=2, padded=False)
        x = self._conv("Conv2d_2a_3x3", x, padded=False)
        x = functional.max_pool2d(self._conv("Conv2d_2b_3x3", x), 3, stride=2)
        x = self._conv("Conv2d_4a_3x3", self._conv("Conv2d_3b_1x1", x), padded=False)
        x = functional.max_pool2d(x, 3, stride=2)
        for block in ("Mixed_5b", "Mixed_5c", "Mixed_5d"):
            x = torch.cat(
                [
                    self._chain(block, x, "branch1x1"),
                    self._chain(block, x, "branch5x5_1", "branch5x5_2"),
                    self._chain(block, x, *(f"branch3x3dbl_{i}" for i in (1, 2, 3))),
                    self._pool_branch(block, x),
                ],
                dim=1,
            )
        dense = self._chain("Mixed_6a", x, "branch3x3dbl_1", "branch3x3dbl_2")
        x = torch.cat(
            [
                self._conv("Mixed_6a.branch3x3", x, stride=2, padded=False),
                self._conv("Mixed_6a.branch3x3dbl_3", dense, stride=2, padded=False),
                functional.max_pool2d(x, 3, stride=2),
            ],
            dim=1,
        )
        for block in ("Mixed_6b", "Mixed_6c", "Mixed_6d", "Mixed_6e"):
            x = torch.cat(
                [
                    self._chain(block, x, "branch1x1"),
                    self._chain(block, x, *(f"branch7x7_{i}" for i in (1, 2, 3))),
                    self._chain(block, x, *(f"branch7x7dbl_{i}" for i in (1, 2, 3, 4, 5))),
                    self._pool_branch(block, x),
                ],
                dim=1,
            )
        short = self._chain("Mixed_7a", x, "branch3x3_1")
        long = self._chain("Mixed_7a", x, *(f"branch7x7x3_{i}" for i in (1, 2, 3)))
        x = torch.cat(
            [
                self._conv("Mixed_7a.branch3x3_2", short, stride=2, padded=False),
                self._conv("Mixed_7a.branch7x7x3_4", long, stride=2, padded=False),
                functional.max_pool2d(x, 3, stride=2),
            ],
            dim=1,
        )
        for block in ("Mixed_7b", "Mixed_7c"):
            short = self._chain(block, x, "branch3x3_1")
            long = self._chain(block, x, "branch3x3dbl_1", "branch3x3dbl_2")
            x = torch.cat(
                [
                    self._chain(block, x, "branch1x1"),
                    self._conv(f"{block}.branch3x3_2a", short),
                    self._conv(f"{block}.branch3x3_2b", short),
                    self._conv(f"{block}.branch3x3dbl_3a", long),
                    self._conv(f"{block}.branch3x3dbl_3b", long),
                    self._pool_branch(block, x),
                ],
                dim=1,
            )
        return x

    def _chain(self, block: str, x: Tensor, *branches: str) -> Tensor:
        for branch in branches:
            x = self._conv(f"{block}.{branch}", x)
        return x

    def _pool_branch(self, block: str, x: Tensor) -> Tensor:
        if self.fid and block == "Mixed_7c":
            pooled = functional.max_pool2d(x, 3, stride=1, padding=1)
        else:
            pooled = functional.avg_pool2d(
                x, 3, stride=1, padding=1, count_include_pad=not self.fid
            )
        return self._conv(f"{block}.branch_pool", pooled)

    def _conv(self, name: str, x: Tensor, stride: int = 1, padded: bool = True) -> Tensor:
        kernel, offset = self._weights[name]
        height, width = kernel.shape[2:]
        padding = (height // 2, width // 2) if padded else (0, 0)
        return functional.conv2d(x, kernel, offset, stride=stride, padding=padding).relu()


def load_inception(path: Path) -> Inception:
    """Read the weights.

    Raises:
        InputError: no file, unreadable, of another network, or a value that is not finite.
    """
    state = read_tensors(path, "Inception weights", _MEND)
    head = state.get("fc.weight")
    classes = None if head is None else head.shape[0]
    if classes not in (_FID_CLASSES, _IMAGENET_CLASSES):
        raise InputError(path, "fc.weight", "is of no known network", _MEND)
    weights = {}
    for name, (before, after, height, width) in CONVOLUTIONS.items():
        kernel = checked_weight(
            state, f"{name}.conv.weight", (after, before, height, width), path, _MEND
        )
        scale, offset, mean, variance = (
            checked_weight(state, f"{name}.bn.{part}", (after,), path, _MEND)
            for part in ("weight", "bias", "running_mean", "running_var")
        )
        scale = scale / (variance + _BN_EPSILON).sqrt()
        weights[name] = (kernel * scale[:, None, None, None], offset - mean * scale)
    return Inception(weights, fid=classes == _FID_CLASSES)
