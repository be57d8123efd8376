"""Decoder of the sparse structure: latent grid to occupancy logits and occupied voxels."""

from __future__ import annotations

from itertools import pairwise
from typing import ClassVar

import torch
from torch import Tensor, nn

from recast.trellis.layers import ChannelLayerNorm32
from recast.trellis.models.base import ModelConfig, Size, TrellisModel
from recast.trellis.models.ss_blocks import (
    SparseStructureVaeConfig,
    Upsample3d,
    channels_last,
    residual_blocks,
    zero_last_convolutions,
)


class SparseStructureDecoderConfig(SparseStructureVaeConfig):
    """Arguments of `SparseStructureDecoder`.

    Args:
        out_channels: channels of the grid; 1 for occupancy.
    """

    out_channels: Size


class SparseStructureDecoder(TrellisModel):
    """Convolutional decoder of the sparse-structure autoencoder; official size 16^3 to 64^3."""

    published_name = "SparseStructureDecoder"
    config_class: ClassVar[type[ModelConfig]] = SparseStructureDecoderConfig
    torso = ("blocks", "middle_block")
    config: SparseStructureDecoderConfig

    def __init__(self, config: SparseStructureDecoderConfig) -> None:
        super().__init__(config)
        levels = config.channels
        self.input_layer = nn.Conv3d(config.latent_channels, levels[0], 3, padding=1)
        middle = residual_blocks(levels[0], config.num_res_blocks_middle)
        self.middle_block = nn.Sequential(*middle)
        self.blocks = nn.ModuleList(residual_blocks(levels[0], config.num_res_blocks))
        for coarse, fine in pairwise(levels):
            self.blocks.append(Upsample3d(coarse, fine))
            self.blocks.extend(residual_blocks(fine, config.num_res_blocks))
        self.out_layer = nn.Sequential(
            ChannelLayerNorm32(levels[-1]),
            nn.SiLU(),
            nn.Conv3d(levels[-1], config.out_channels, 3, padding=1),
        )
        self.finish()

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Convolutions as in PyTorch; each residual block starts as the identity."""
        super().initialise(generator)
        zero_last_convolutions([*self.blocks, *self.middle_block])

    def forward(self, z: Tensor) -> Tensor:
        """Occupancy logits; a voxel is occupied where its logit is positive.

        Args:
            z: (B, latent_channels, r, r, r) latents, not normalised.

        Returns:
            (B, out_channels, R, R, R) with R = r 2^(levels - 1), in the dtype of `z`.
        """
        h = self.input_layer(channels_last(z)).to(self.torso_dtype)
        for block in (*self.middle_block, *self.blocks):
            h = self.run_block(block, h)
        logits: Tensor = self.out_layer(h.to(z.dtype))
        return logits


def occupied_voxels(logits: Tensor) -> Tensor:
    """Voxels with a positive logit.

    Args:
        logits: (B, 1, R, R, R).

    Returns:
        (T, 4) int32 rows [batch, x, y, z], sorted lexicographically.
    """
    return torch.argwhere(logits > 0)[:, [0, 2, 3, 4]].int()
