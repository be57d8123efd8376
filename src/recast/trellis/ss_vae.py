"""The sparse structure's autoencoder: occupancy grid to a small latent grid, to occupied voxels."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import ClassVar, Literal

import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from recast.trellis.layers import (
    ChannelLayerNorm32,
    Depth,
    ModelConfig,
    Posterior,
    Size,
    TrellisModel,
    start_at_zero,
)


class SparseStructureVaeConfig(ModelConfig):
    """Arguments that `SparseStructureEncoder` and `SparseStructureDecoder` share.

    Args:
        latent_channels: channels of the latent.
        num_res_blocks: residual blocks of each level.
        channels: channels of each level, in the order of the data; levels differ by two in
            resolution.
        num_res_blocks_middle: residual blocks at the coarsest level beside those.
        norm_type: kind of normalisation; no other value was published.
    """

    latent_channels: Size
    num_res_blocks: Depth
    channels: tuple[Size, ...] = Field(min_length=1, max_length=16)
    num_res_blocks_middle: Depth = 2
    norm_type: Literal["layer"] = "layer"


class ResBlock3d(nn.Module):
    """x + conv(SiLU(norm(conv(SiLU(norm(x)))))), with 3x3x3 convolutions.

    The published networks never change the channels inside a block.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm1 = ChannelLayerNorm32(channels)
        self.norm2 = ChannelLayerNorm32(channels)
        self.conv1 = nn.Conv3d(channels, channels, 3, padding=1)
        self.conv2 = nn.Conv3d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """Grid (B, channels, X, Y, Z) to the same shape."""
        h = self.conv1(functional.silu(self.norm1(x)))
        return x + self.conv2(functional.silu(self.norm2(h)))


def downsample_3d(in_channels: int, out_channels: int) -> nn.Sequential:
    """Grid (B, in_channels, 2X, 2Y, 2Z) to (B, out_channels, X, Y, Z).

    A 2x2x2 convolution of stride 2.
    """
    return nn.Sequential(OrderedDict(conv=nn.Conv3d(in_channels, out_channels, 2, stride=2)))


class Upsample3d(nn.Module):
    """Double a grid: a 3x3x3 convolution to eight times the channels, then a pixel shuffle."""

    def __init__(self, in_channels: int, out_channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv3d(in_channels, 8 * out_channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """Grid (B, in_channels, X, Y, Z) to (B, out_channels, 2X, 2Y, 2Z)."""
        return channels_last(pixel_shuffle_3d(self.conv(x)))


def channels_last(grid: Tensor) -> Tensor:
    """The same grid (B, C, X, Y, Z), channels last in memory.

    The norms want it so, and with few channels the convolutions then take half the time on a CPU.
    """
    return grid.contiguous(memory_format=torch.channels_last_3d)


def pixel_shuffle_3d(x: Tensor, factor: int = 2) -> Tensor:
    """Move channels into space: channel c r^3 + (dx r + dy) r + dz goes to cell offset dx, dy, dz.

    From (B, C r^3, X, Y, Z) to (B, C, r X, r Y, r Z), r = `factor`.
    """
    batch, _, *size = x.shape
    split = x.reshape(batch, -1, factor, factor, factor, *size)
    woven = split.permute(0, 1, 5, 2, 6, 3, 7, 4)
    return woven.reshape(batch, split.shape[1], *(factor * n for n in size))


class SparseStructureVae(TrellisModel):
    """What encoder and decoder share; a subclass adds `blocks` and `middle_block` in its order."""

    torso = ("blocks", "middle_block")
    config: SparseStructureVaeConfig
    input_layer: nn.Conv3d
    out_layer: nn.Sequential

    def res_blocks(self, channels: int, count: int) -> nn.Sequential:
        """Residual blocks in a row."""
        return nn.Sequential(*(ResBlock3d(channels) for _ in range(count)))

    def levels(self, change: Callable[[int, int], nn.Module]) -> nn.ModuleList:
        """The residual blocks of each level, and what takes one to the next between them."""
        channels, count = self.config.channels, self.config.num_res_blocks
        blocks = nn.ModuleList(self.res_blocks(channels[0], count))
        for before, after in pairwise(channels):
            blocks.append(change(before, after))
            blocks.extend(self.res_blocks(after, count))
        return blocks

    def head(self, out_channels: int) -> nn.Sequential:
        """The output layer."""
        last = self.config.channels[-1]
        return nn.Sequential(
            ChannelLayerNorm32(last), nn.SiLU(), nn.Conv3d(last, out_channels, 3, padding=1)
        )

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Convolutions as in PyTorch; each residual block starts as the identity."""
        super().initialise(generator)
        for block in self.modules():
            if isinstance(block, ResBlock3d):
                start_at_zero(block.conv2)

    def run(self, x: Tensor, blocks: Iterable[nn.Module]) -> Tensor:
        """Input layer, blocks in the torso's precision, output layer."""
        h = self.input_layer(channels_last(x))
        outer = h.dtype
        h = h.to(self.torso_dtype)
        for block in blocks:
            h = self.run_block(block, h)
        return self.out_layer(h.to(outer))


class SparseStructureEncoderConfig(SparseStructureVaeConfig):
    """Arguments of `SparseStructureEncoder`.

    Args:
        in_channels: channels of the grid; 1 for occupancy.
    """

    in_channels: Size


class SparseStructureEncoder(SparseStructureVae):
    """Convolutional encoder of the sparse-structure autoencoder; official size 64^3 to 16^3."""

    published_name = "SparseStructureEncoder"
    config_class: ClassVar[type[ModelConfig]] = SparseStructureEncoderConfig
    config: SparseStructureEncoderConfig

    def __init__(self, config: SparseStructureEncoderConfig) -> None:
        super().__init__(config)
        levels = config.channels
        self.input_layer = nn.Conv3d(config.in_channels, levels[0], 3, padding=1)
        self.blocks = self.levels(downsample_3d)
        self.middle_block = self.res_blocks(levels[-1], config.num_res_blocks_middle)
        self.out_layer = self.head(2 * config.latent_channels)
        self.finish()

    def forward(self, grid: Tensor) -> Posterior:
        """Distribution of the latent.

        Args:
            grid: (B, in_channels, R, R, R) occupancy 0 or 1, in any dtype.

        Returns:
            Mean and logvar (B, latent_channels, R / f, R / f, R / f) with f = 2^(levels - 1).
        """
        grid = grid.to(self.input_layer.weight.dtype)
        mean, logvar = self.run(grid, (*self.blocks, *self.middle_block)).chunk(2, dim=1)
        return Posterior(mean, logvar)


class SparseStructureDecoderConfig(SparseStructureVaeConfig):
    """Arguments of `SparseStructureDecoder`.

    Args:
        out_channels: channels of the grid; 1 for occupancy.
    """

    out_channels: Size


class SparseStructureDecoder(SparseStructureVae):
    """Convolutional decoder of the sparse-structure autoencoder; official size 16^3 to 64^3."""

    published_name = "SparseStructureDecoder"
    config_class: ClassVar[type[ModelConfig]] = SparseStructureDecoderConfig
    config: SparseStructureDecoderConfig

    def __init__(self, config: SparseStructureDecoderConfig) -> None:
        super().__init__(config)
        levels = config.channels
        self.input_layer = nn.Conv3d(config.latent_channels, levels[0], 3, padding=1)
        self.middle_block = self.res_blocks(levels[0], config.num_res_blocks_middle)
        self.blocks = self.levels(Upsample3d)
        self.out_layer = self.head(config.out_channels)
        self.finish()

    def forward(self, z: Tensor) -> Tensor:
        """Occupancy logits; a voxel is occupied where its logit is positive.

        Args:
            z: (B, latent_channels, r, r, r) latents, not normalised.

        Returns:
            (B, out_channels, R, R, R) with R = r 2^(levels - 1), in the dtype of `z`.
        """
        return self.run(z, (*self.middle_block, *self.blocks))


def occupied_voxels(logits: Tensor) -> Tensor:
    """Voxels of logits (B, 1, R, R, R) above zero: (T, 4) int32 rows [batch, x, y, z].

    The rows are sorted lexicographically.
    """
    return torch.argwhere(logits > 0)[:, [0, 2, 3, 4]].int()
