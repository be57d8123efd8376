"""Encoder of the sparse structure: occupancy grid to a small dense latent grid."""

from __future__ import annotations

from itertools import pairwise
from typing import ClassVar

import torch
from torch import Tensor, nn

from recast.trellis.layers import ChannelLayerNorm32
from recast.trellis.models.base import ModelConfig, Size, TrellisModel
from recast.trellis.models.posterior import Posterior
from recast.trellis.models.ss_blocks import (
    Downsample3d,
    SparseStructureVaeConfig,
    channels_last,
    residual_blocks,
    zero_last_convolutions,
)


class SparseStructureEncoderConfig(SparseStructureVaeConfig):
    """Arguments of `SparseStructureEncoder`.

    Args:
        in_channels: channels of the grid; 1 for occupancy.
    """

    in_channels: Size


class SparseStructureEncoder(TrellisModel):
    """Convolutional encoder of the sparse-structure autoencoder; official size 64^3 to 16^3."""

    published_name = "SparseStructureEncoder"
    config_class: ClassVar[type[ModelConfig]] = SparseStructureEncoderConfig
    torso = ("blocks", "middle_block")
    config: SparseStructureEncoderConfig

    def __init__(self, config: SparseStructureEncoderConfig) -> None:
        super().__init__(config)
        levels = config.channels
        self.input_layer = nn.Conv3d(config.in_channels, levels[0], 3, padding=1)
        self.blocks = nn.ModuleList(residual_blocks(levels[0], config.num_res_blocks))
        for fine, coarse in pairwise(levels):
            self.blocks.append(Downsample3d(fine, coarse))
            self.blocks.extend(residual_blocks(coarse, config.num_res_blocks))
        middle = residual_blocks(levels[-1], config.num_res_blocks_middle)
        self.middle_block = nn.Sequential(*middle)
        self.out_layer = nn.Sequential(
            ChannelLayerNorm32(levels[-1]),
            nn.SiLU(),
            nn.Conv3d(levels[-1], 2 * config.latent_channels, 3, padding=1),
        )
        self.finish()

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Convolutions as in PyTorch; each residual block starts as the identity."""
        super().initialise(generator)
        zero_last_convolutions([*self.blocks, *self.middle_block])

    def forward(self, grid: Tensor) -> Posterior:
        """Distribution of the latent.

        Args:
            grid: (B, in_channels, R, R, R) occupancy 0 or 1, in any dtype.

        Returns:
            Mean and logvar (B, latent_channels, R / f, R / f, R / f) with f = 2^(levels - 1).
        """
        h = self.input_layer(channels_last(grid.to(self.input_layer.weight.dtype)))
        outer = h.dtype
        h = h.to(self.torso_dtype)
        for block in (*self.blocks, *self.middle_block):
            h = self.run_block(block, h)
        mean, logvar = self.out_layer(h.to(outer)).chunk(2, dim=1)
        return Posterior(mean, logvar)
