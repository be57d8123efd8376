"""Flow transformer of the structured latents: velocities of the features of given voxels."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import ClassVar, Self

import torch
from pydantic import Field, model_validator
from torch import Tensor, nn

from recast.trellis.layers import (
    absolute_positions,
    final_norm,
)
from recast.trellis.models.base import Depth, ModelConfig, Size, start_at_zero
from recast.trellis.models.flow_transformer import FlowConfig, FlowTransformer
from recast.trellis.models.sparse_res_block import SparseResBlock3d
from recast.trellis.sparse import PackedTokens, SparseTensor, SubMConv3d, pool


class SLatFlowConfig(FlowConfig):
    """Arguments of `SLatFlowModel`.

    Args:
        patch_size: edge, in voxels, of what becomes one token: 2 to the number of
            `io_block_channels`.
        num_io_res_blocks: residual blocks of each level before and after the transformer.
        io_block_channels: of each level, fine to coarse; None has no levels.
        use_skip_connection: hand the outputs of the input blocks to the output blocks.
    """

    patch_size: Size = 2
    num_io_res_blocks: Depth = 2
    io_block_channels: tuple[Size, ...] | None = Field(default=None, max_length=16)
    use_skip_connection: bool = True

    @model_validator(mode="after")
    def _levels_match_the_patch(self) -> Self:
        levels = self.io_block_channels
        if levels is not None and 2 ** len(levels) != self.patch_size:
            raise ValueError(
                f"patch_size {self.patch_size} is not 2 to the number of io_block_channels {levels}"
            )
        return self


class SLatFlowModel(FlowTransformer):
    """Velocity of the latents of a sparse set of voxels, given a time and an image.

    Residual blocks of submanifold convolutions pool the voxels to the tokens of a transformer with
    adaptive layer norm and cross-attention to the image, and take its tokens back to the voxels
    (Xiang et al., Structured 3D Latents for Scalable and Versatile 3D Generation, CVPR 2025).

    Args:
        config: constructor arguments.
    """

    published_name: ClassVar[str] = "SLatFlowModel"
    config_class: ClassVar[type[ModelConfig]] = SLatFlowConfig
    torso: ClassVar[tuple[str, ...]] = ("input_blocks", "blocks", "out_blocks")
    config: SLatFlowConfig

    def __init__(self, config: SLatFlowConfig) -> None:
        super().__init__(config)
        c = config.model_channels
        widths = [*(config.io_block_channels or ()), c]
        repeats = config.num_io_res_blocks - 1
        sources = 2 if config.use_skip_connection else 1
        self.input_layer = nn.Linear(config.in_channels, widths[0])
        self.input_blocks = nn.ModuleList()
        self.out_blocks = nn.ModuleList()
        for fine, coarse in pairwise(widths):
            self.input_blocks.extend(SparseResBlock3d(fine, c, fine) for _ in range(repeats))
            self.input_blocks.append(SparseResBlock3d(fine, c, coarse))
        self.blocks = self.cross_blocks()
        for coarse, fine in pairwise(reversed(widths)):
            self.out_blocks.append(SparseResBlock3d(sources * coarse, c, fine))
            self.out_blocks.extend(
                SparseResBlock3d(sources * fine, c, fine) for _ in range(repeats)
            )
        self.out_layer = nn.Linear(widths[0], config.out_channels)
        self.finish()

    @torch.no_grad()
    def initialise(self, generator: torch.Generator | None = None) -> None:
        """As the base; residual blocks start as their skip connection, the velocity at zero."""
        super().initialise(generator)
        for module in self.modules():
            if isinstance(module, SubMConv3d):
                bound = 1 / math.sqrt(27 * module.in_channels)
                for parameter in module.parameters():
                    nn.init.uniform_(parameter, -bound, bound, generator=generator)
        for block in (*self.input_blocks, *self.out_blocks):
            start_at_zero(block.conv2)
        start_at_zero(self.out_layer)

    def forward(self, x: SparseTensor, t: Tensor, cond: Tensor) -> SparseTensor:
        """Velocities of noisy latents.

        Args:
            x: (T, in_channels) normalised latents of the voxels of B samples.
            t: (B,) times, already multiplied by 1000.
            cond: (B, L, cond_channels) image tokens.

        Returns:
            (T, out_channels) on the voxels of `x`, in its dtype.
        """
        dtype = self.torso_dtype
        t_emb, modulation = self.modulation(t, cond)
        cond = cond.to(dtype)

        h = x.with_feats(self.input_layer(x.feats).to(dtype))
        per_level = self.config.num_io_res_blocks
        skips, indices = [], []
        for i, block in enumerate(self.input_blocks, start=1):
            if i % per_level == 0:
                h, index = pool(h)
                indices.append(index)
            h = self.run_block(block, h, t_emb)
            skips.append(h.feats)

        tokens = h.feats + absolute_positions(h.coords[:, 1:], h.feats.shape[1]).to(dtype)
        layout = PackedTokens(h)
        for block in self.blocks:
            tokens = self.run_block(block, tokens, modulation, cond, layout)

        h = h.with_feats(tokens)
        for i, block in enumerate(self.out_blocks):
            if self.config.use_skip_connection:
                h = h.with_feats(torch.cat([h.feats, skips.pop()], dim=1))
            h = self.run_block(block, h, t_emb, indices.pop() if i % per_level == 0 else None)
        # As in the published model, this norm runs in the torso's precision.
        return x.with_feats(self.out_layer(final_norm(h.feats).to(x.feats.dtype)))
