"""The seam between crops and generation: what every image encoder offers; and one for a CPU."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar, Protocol, Self, runtime_checkable

import numpy as np
import torch
from pydantic import Field, model_validator
from torch import Tensor, nn

from recast.arrays import Image
from recast.trellis.attention import DenseTokens, final_norm
from recast.trellis.blocks import TransformerBlock
from recast.trellis.models.base import DEEPEST, ModelConfig, Ratio, Size, TrellisModel

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
