"""Pictures of one cut-out object: read and checked, and cropped to the square that conditions.

The published TRELLIS code crops in two ways: one rule in its pipeline, another in its training
data. Recast uses the pipeline's rule, `crop_to_object`, in training and in generation alike. Not
only do the two then agree; the trainer's rule follows every pixel whose alpha is not zero, so a
faint speck far from the object, as segmenters leave, shifts and shrinks the whole crop, where the
pipeline's rule looks at alpha above 0.8 only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Protocol, Self, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image as PilImage
from pydantic import Field, model_validator
from torch import Tensor, nn

from recast.arrays import Image
from recast.core.errors import InputError
from recast.core.images import FORMATS, decode_image, eight_bits
from recast.trellis.layers import (
    DEEPEST,
    DenseTokens,
    ModelConfig,
    Ratio,
    Size,
    TransformerBlock,
    TrellisModel,
    final_norm,
)

OPAQUE = 204
"""Alpha above this value (0.8 of 255) belongs to the object, as in the published pipeline."""

SMALLEST = 8
"""Pixels of an object's longer side below which there is nothing to generate from."""

_SEGMENT = "cut the object out (PNG with an alpha mask), or let `recast actor make` do it from logs"
MARGIN = 1.2
"""Side of the square crop over the longer side of the object's box."""


def read_crop(path: str | Path) -> Image:
    """Read and check the picture of one cut-out object.

    PNG, WebP, TIFF and GIF are taken: 8 and 16 bits, palettes, grey with alpha, one transparent
    colour. A stored orientation (EXIF) is applied.

    Returns:
        (H, W, 4) uint8 RGBA, straight alpha (colours not multiplied by it).

    Raises:
        InputError: missing, unreadable or cut short, without alpha, or refused by `check_crop`.
    """
    path = Path(path)
    levels = decode_image(path, path, (*FORMATS, "GIF"))
    if levels.shape[2:] != (4,):
        raise InputError(path, "alpha", "is absent", _SEGMENT)
    rgba = eight_bits(levels)
    check_crop(rgba, path)
    return rgba


def check_crop(rgba: Image, where: str | Path) -> None:
    """Refuse a picture that holds no cut-out object.

    Args:
        rgba: (H, W, 4) uint8, straight alpha.
        where: file or source to name in the error.

    Raises:
        InputError: no alpha channel, transparent everywhere, opaque everywhere, alpha nowhere
            above 0.8, or an object whose longer side is less than `SMALLEST` pixels.
    """
    if rgba.ndim != 3 or rgba.shape[2] != 4 or rgba.dtype != np.uint8:
        shape = "x".join(str(n) for n in rgba.shape)
        raise InputError(where, "alpha", f"is absent ({shape} {rgba.dtype})", _SEGMENT)
    alpha = rgba[..., 3]
    strongest = int(alpha.max(initial=0))
    if strongest == 0:
        raise InputError(
            where, "alpha", "is zero everywhere: the image shows nothing", "check the mask"
        )
    if strongest <= OPAQUE:
        problem = f"never exceeds 0.8 (largest {strongest / 255:.2f}): no object stands out"
        raise InputError(where, "alpha", problem, "make the mask opaque on the object")
    if int(alpha.min()) > OPAQUE:
        raise InputError(where, "alpha", "is opaque everywhere: no object is cut out", _SEGMENT)
    left, top, right, bottom = object_box(alpha)
    width, height = right - left + 1, bottom - top + 1
    if max(width, height) < SMALLEST:
        raise InputError(
            where,
            "object",
            f"is {width}x{height} pixels, at least {SMALLEST} are needed",
            "use a closer view, or clean the mask",
        )


def object_box(alpha: Image, threshold: int = OPAQUE) -> tuple[int, int, int, int]:
    """Left, top, right, bottom in pixels, all inclusive, of where alpha is above `threshold`.

    Args:
        alpha: (H, W) uint8 with at least one such pixel.
    """
    inside = alpha > threshold
    columns, rows = np.flatnonzero(inside.any(axis=0)), np.flatnonzero(inside.any(axis=1))
    return int(columns[0]), int(rows[0]), int(columns[-1]), int(rows[-1])


def crop_to_object(rgba: Image, size: int, where: str | Path = "crop") -> Image:
    """Cut the square around the object, scale it, put it on black: recast's only rule.

    The object is where alpha exceeds 0.8. The square is centred on its box, has 1.2 times its
    longer side and may leave the picture, outside of which all is transparent. Equal to the last
    bit to the published pipeline with the same version of Pillow: Lanczos on premultiplied
    colours, then colour times alpha, cut off (not rounded) to 8 bits.

    Args:
        rgba: (H, W, 4) uint8, straight alpha.
        size: side of the result in pixels; 518 for DINOv2.
        where: file or source to name in an error.

    Returns:
        (size, size, 3) uint8 RGB on black.

    Raises:
        InputError: as `check_crop`.
    """
    check_crop(rgba, where)
    left, top, right, bottom = object_box(rgba[..., 3])
    centre_x, centre_y = (left + right) / 2, (top + bottom) / 2
    half = int(MARGIN * max(right - left, bottom - top)) // 2
    # Pillow rounds halves to even here, which the published pipeline leaves to it.
    box = (centre_x - half, centre_y - half, centre_x + half, centre_y + half)
    scaled = _scaled_crop(rgba, box, size)
    unit = np.asarray(scaled, np.float32) / 255
    return np.asarray(unit[..., :3] * unit[..., 3:] * 255).astype(np.uint8)


def training_crop(rgba: Image, size: int, where: str | Path = "crop") -> NDArray[np.float32]:
    """The rule of the published trainer, kept to compare with; recast itself never uses it.

    Differs from `crop_to_object` in three ways: the object is wherever alpha is not zero (a faint
    speck shifts the crop), the square's borders are cut off to whole pixels instead of rounded,
    and the product of colour and alpha stays in float.

    Args:
        rgba, size, where: see `crop_to_object`.

    Returns:
        (3, size, size) float32 RGB on black, in [0, 1].

    Raises:
        InputError: as `check_crop`.
    """
    check_crop(rgba, where)
    left, top, right, bottom = object_box(rgba[..., 3], threshold=0)
    centre_x, centre_y = (left + right) / 2, (top + bottom) / 2
    half = max(right - left, bottom - top) / 2 * MARGIN
    corners = (centre_x - half, centre_y - half, centre_x + half, centre_y + half)
    scaled = _scaled_crop(rgba, tuple(int(value) for value in corners), size)
    unit = np.asarray(scaled, np.float32) / 255
    return np.ascontiguousarray((unit[..., :3] * unit[..., 3:]).transpose(2, 0, 1))


def _scaled_crop(rgba: Image, box: tuple[float, ...], size: int) -> PilImage.Image:
    image = PilImage.fromarray(rgba)
    return image.crop(box).resize((size, size), PilImage.Resampling.LANCZOS)  # type: ignore[arg-type]


# Mean and standard deviation of ImageNet's pixels, with which DINOv2 was trained.
_MEAN = (0.485, 0.456, 0.406)
_STD = (0.229, 0.224, 0.225)


@runtime_checkable
class ImageEncoder(Protocol):
    """Turns square crops on black into the context of the generation's cross-attention."""

    @property
    def image_size(self) -> int:
        """Side of the crops in pixels, to give to `crop_to_object`."""
        ...

    @property
    def channels(self) -> int:
        """Channels of a token."""
        ...

    def encode(self, images: Tensor) -> Tensor:
        """Crops (B, 3, S, S) float32 in [0, 1] to tokens (B, L, channels), layer-normalised."""
        ...


def images_from_crops(crops: Sequence[Image]) -> Tensor:
    """Stack B crops (S, S, 3) uint8 of `crop_to_object` for an encoder.

    Returns:
        (B, 3, S, S) float32 in [0, 1].
    """
    stacked = torch.from_numpy(np.stack(crops))
    return stacked.permute(0, 3, 1, 2).float().div(255)


def normalise(images: Tensor) -> Tensor:
    """Images (B, 3, H, W) in [0, 1] to zero mean and unit deviation over ImageNet."""
    mean, std = (images.new_tensor(values).view(3, 1, 1) for values in (_MEAN, _STD))
    return (images - mean) / std


class CompactImageEncoderConfig(ModelConfig):
    """Arguments of `CompactImageEncoder`; the defaults make about a million parameters.

    Args:
        image_size: side of the crops in pixels.
        stem_channels: channels after each halving of the picture but the last, which gives
            `channels`; a token thus stands for 2^(1 + their number) pixels a side.
        channels: channels of a token.
        num_blocks: transformer blocks.
        num_heads: attention heads.
        mlp_ratio: hidden channels of the MLPs over `channels`.
    """

    image_size: int = Field(default=128, ge=1, le=4096)
    stem_channels: tuple[Size, ...] = Field(default=(32, 64), max_length=11)
    channels: Size = 128
    num_blocks: int = Field(default=4, ge=0, le=DEEPEST)
    num_heads: Size = 4
    mlp_ratio: Ratio = 4.0

    @property
    def patch_size(self) -> int:
        """Side in pixels of what one token stands for."""
        return int(2 ** (len(self.stem_channels) + 1))

    @property
    def grid(self) -> int:
        """Tokens along a side of the picture."""
        return self.image_size // self.patch_size

    @model_validator(mode="after")
    def _divides(self) -> Self:
        if self.image_size % self.patch_size:
            raise ValueError(
                f"image_size {self.image_size} does not divide into patches of {self.patch_size}"
            )
        if self.channels % self.num_heads or self.channels % 4:
            raise ValueError(
                f"channels {self.channels} must be a multiple of 4 and of {self.num_heads} heads"
            )
        return self


class CompactImageEncoder(TrellisModel):
    """Convolutions that halve the picture to a grid of tokens, then a small transformer.

    Convolutions before the transformer make it train steadily on few pictures (Xiao et al. 2021,
    "Early convolutions help transformers see better"); the grid's position embedding is learnt,
    beginning with sines and cosines. Stands in for DINOv2 in models of a few million parameters
    and trains together with them.
    """

    published_name: ClassVar[str] = "CompactImageEncoder"
    config_class: ClassVar[type[ModelConfig]] = CompactImageEncoderConfig
    torso: ClassVar[tuple[str, ...]] = ("blocks",)
    config: CompactImageEncoderConfig

    def __init__(self, config: CompactImageEncoderConfig) -> None:
        super().__init__(config)
        stem: list[nn.Module] = []
        inside = 3
        for outside in config.stem_channels:
            # Statistics of one picture: those of a batch would mix the crops in it.
            stem += [_halving(inside, outside), nn.GroupNorm(1, outside), nn.GELU()]
            inside = outside
        self.stem = nn.Sequential(*stem, _halving(inside, config.channels))
        self.class_token = nn.Parameter(torch.empty(1, 1, config.channels))
        self.pos_emb = nn.Parameter(torch.empty(config.grid**2, config.channels))
        self.blocks = nn.ModuleList(
            TransformerBlock(config.channels, config.num_heads, config.mlp_ratio)
            for _ in range(config.num_blocks)
        )
        self.finish()

    @torch.no_grad()
    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw initial weights; position embeddings start as small sines and cosines."""
        super().initialise(generator)
        nn.init.trunc_normal_(self.class_token, std=0.02, generator=generator)
        # At full size they would drown what the convolutions see, whose deviation is 0.2 to 0.4.
        self.pos_emb.copy_(0.1 * grid_positions(self.config.grid, self.config.channels))

    @property
    def image_size(self) -> int:
        """Side of the crops in pixels."""
        return self.config.image_size

    @property
    def channels(self) -> int:
        """Channels of a token."""
        return self.config.channels

    def encode(self, images: Tensor) -> Tensor:
        """Tokens of crops (B, 3, S, S) in [0, 1], S the `image_size`.

        Returns:
            (B, 1 + grid * grid, channels): a token of the whole picture, then the grid row by
            row; layer-normalised (no weights, eps 1e-5) as the context of the flow models is.

        Raises:
            ValueError: images of another size.
        """
        side = self.config.image_size
        if tuple(images.shape[1:]) != (3, side, side):
            raise ValueError(f"images are {tuple(images.shape)}, not (B, 3, {side}, {side})")
        patches = self.stem(normalise(images)).flatten(2).transpose(1, 2) + self.pos_emb
        tokens = torch.cat([self.class_token.expand(len(images), -1, -1), patches], dim=1)
        tokens, layout = tokens.to(self.torso_dtype), DenseTokens()
        for block in self.blocks:
            tokens = self.run_block(block, tokens, layout)
        return final_norm(tokens.to(images.dtype))

    forward = encode


def grid_positions(grid: int, channels: int) -> Tensor:
    """Sines and cosines of the rows and columns of a square grid: (grid * grid, C), row by row.

    Sine and cosine of the row, then of the column, of C / 4 wavelengths each, from 2 pi to
    2 pi * 10000 cells. C is `channels`, a multiple of 4; `grid` is the number of cells along a
    side.
    """
    quarter = channels // 4
    frequencies = torch.exp(torch.arange(quarter) * (-math.log(10000.0) / quarter))
    phases = torch.arange(grid).unsqueeze(1) * frequencies
    axis = torch.cat([phases.sin(), phases.cos()], dim=1)
    rows = axis.unsqueeze(1).expand(grid, grid, -1)
    columns = axis.unsqueeze(0).expand(grid, grid, -1)
    return torch.cat([rows, columns], dim=2).reshape(grid * grid, channels)


def _halving(inside: int, outside: int) -> nn.Conv2d:
    return nn.Conv2d(inside, outside, kernel_size=3, stride=2, padding=1)
