"""The flow transformers: velocities of the dense grid of structure, and of features of voxels."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import ClassVar, Self

import torch
from pydantic import Field, model_validator
from torch import Tensor, nn

from recast.trellis.layers import (
    DenseTokens,
    Depth,
    ModelConfig,
    ModulatedCrossBlock,
    Size,
    SparseResBlock3d,
    TimestepEmbedder,
    TransformerConfig,
    TrellisModel,
    absolute_positions,
    final_norm,
    modulation_layer,
    start_at_zero,
)
from recast.trellis.sparse import PackedTokens, SparseTensor, pool
from recast.trellis.sparse_convolution import SubMConv3d


class FlowConfig(TransformerConfig):
    """Arguments that `SparseStructureFlowModel` and `SLatFlowModel` share.

    Args:
        resolution: R, cells of the latent along an axis.
        in_channels: channels of the latent.
        out_channels: channels of the velocity.
        cond_channels: channels of the image tokens.
        share_mod: one modulation layer for all blocks.
        qk_rms_norm_cross: normalise queries and keys of the cross-attention.
        pool_cond: also add the first image token, the encoder's summary of the picture, to the time
            embedding. In no published model: small ones that hear of the picture through the
            cross-attention alone learn to ignore it.
    """

    resolution: Size
    in_channels: Size
    out_channels: Size
    cond_channels: Size
    share_mod: bool = False
    qk_rms_norm_cross: bool = False
    pool_cond: bool = False


class FlowTransformer(TrellisModel):
    """Base of the flow transformers; a subclass appends its input, `blocks` and `out_layer`."""

    config: FlowConfig
    out_layer: nn.Linear

    def __init__(self, config: FlowConfig) -> None:
        super().__init__(config)
        channels = config.model_channels
        self.t_embedder = TimestepEmbedder(channels)
        self.adaLN_modulation = modulation_layer(channels) if config.share_mod else None
        self.cond_pool = nn.Linear(config.cond_channels, channels) if config.pool_cond else None

    def cross_blocks(self) -> nn.ModuleList:
        """New transformer blocks, as many as configured."""
        config = self.config
        return nn.ModuleList(
            ModulatedCrossBlock(
                config.model_channels,
                config.cond_channels,
                config.heads,
                config.mlp_ratio,
                qk_rms_norm=config.qk_rms_norm,
                qk_rms_norm_cross=config.qk_rms_norm_cross,
                share_mod=config.share_mod,
            )
            for _ in range(config.num_blocks)
        )

    @torch.no_grad()
    def initialise(self, generator: torch.Generator | None = None) -> None:
        """As the base; shared modulation and output start at zero: no velocity is predicted."""
        super().initialise(generator)
        if self.adaLN_modulation is not None:
            start_at_zero(self.adaLN_modulation)
        start_at_zero(self.out_layer)

    def modulation(self, t: Tensor, cond: Tensor) -> tuple[Tensor, Tensor]:
        """The embedding (B, C) of time, and what modulates the blocks, in the torso's precision.

        Args:
            t: (B,) times, already multiplied by 1000.
            cond: (B, L, cond_channels) image tokens.
        """
        embedding = self.t_embedder(t)
        if self.cond_pool is not None:
            embedding = embedding + self.cond_pool(cond[:, 0])
        modulation = embedding
        if self.adaLN_modulation is not None:
            modulation = self.adaLN_modulation(embedding)
        return embedding.to(self.torso_dtype), modulation.to(self.torso_dtype)


class SparseStructureFlowConfig(FlowConfig):
    """Arguments of `SparseStructureFlowModel`.

    Args:
        patch_size: cells of a token along an axis; must divide the resolution.
    """

    patch_size: Size = 2

    @model_validator(mode="after")
    def _patches_tile_the_grid(self) -> Self:
        if self.resolution % self.patch_size:
            raise ValueError(
                f"patch_size {self.patch_size} does not divide resolution {self.resolution}"
            )
        return self


class SparseStructureFlowModel(FlowTransformer):
    """Diffusion transformer with full attention over a dense latent grid (Xiang et al. 2024).

    `pos_emb`, the position embedding of the patch grid, is a buffer of the checkpoint and no
    parameter.
    """

    published_name = "SparseStructureFlowModel"
    config_class: ClassVar[type[ModelConfig]] = SparseStructureFlowConfig
    torso = ("blocks",)
    config: SparseStructureFlowConfig
    pos_emb: Tensor

    def __init__(self, config: SparseStructureFlowConfig) -> None:
        super().__init__(config)
        channels = config.model_channels
        cells = config.patch_size**3
        tokens = (config.resolution // config.patch_size) ** 3
        self.register_buffer("pos_emb", torch.empty(tokens, channels))
        self.input_layer = nn.Linear(config.in_channels * cells, channels)
        self.blocks = self.cross_blocks()
        self.out_layer = nn.Linear(channels, config.out_channels * cells)
        self.finish()

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """As the base; computes the position embedding."""
        super().initialise(generator)
        along = torch.arange(self.config.resolution // self.config.patch_size)
        coords = torch.cartesian_prod(along, along, along)
        self.pos_emb.copy_(absolute_positions(coords, self.config.model_channels))

    def forward(self, x: Tensor, t: Tensor, cond: Tensor) -> Tensor:
        """Velocity of the flow.

        Args:
            x: (B, in_channels, R, R, R) latents at time t.
            t, cond: see `modulation`.

        Returns:
            (B, out_channels, R, R, R) in the dtype of `x`.

        Raises:
            ValueError: the grid has another shape than this model was built for.
        """
        config, dtype = self.config, self.torso_dtype
        if x.shape[1:] != (config.in_channels, *[config.resolution] * 3):
            raise ValueError(
                f"latents {tuple(x.shape)}: expected {config.in_channels} channels "
                f"on a grid of {config.resolution}^3"
            )
        h = self.input_layer(patchify(x, config.patch_size)) + self.pos_emb
        _, modulation = self.modulation(t, cond)
        h, cond = h.to(dtype), cond.to(dtype)
        layout = DenseTokens()
        for block in self.blocks:
            h = self.run_block(block, h, modulation, cond, layout)
        velocity = self.out_layer(final_norm(h.to(x.dtype)))
        return unpatchify(velocity, config.resolution, config.patch_size)


def patchify(x: Tensor, patch: int) -> Tensor:
    """Grid (B, C, R, R, R) to tokens (B, (R / p)^3, C p^3): z fastest, channels C, px, py, pz."""
    batch, channels, *size = x.shape
    cut = [part for n in size for part in (n // patch, patch)]
    split = x.reshape(batch, channels, *cut).permute(0, 2, 4, 6, 1, 3, 5, 7)
    return split.flatten(4).flatten(1, 3)


def unpatchify(tokens: Tensor, resolution: int, patch: int) -> Tensor:
    """The inverse of `patchify` for a grid of `resolution` cells along each axis."""
    along = resolution // patch
    split = tokens.reshape(tokens.shape[0], along, along, along, -1, patch, patch, patch)
    woven = split.permute(0, 4, 1, 5, 2, 6, 3, 7)
    return woven.reshape(tokens.shape[0], -1, resolution, resolution, resolution)


class SLatFlowConfig(FlowConfig):
    """Arguments of `SLatFlowModel`.

    Args:
        patch_size: edge, in voxels, of what becomes one token: 2 to the number of
            `io_block_channels`.
        num_io_res_blocks: residual blocks of each level before and after the transformer.
        io_block_channels: channels of each level, fine to coarse; None has no levels.
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
        """As the base; residual blocks start as their skip connection."""
        super().initialise(generator)
        for module in self.modules():
            if isinstance(module, SubMConv3d):
                bound = 1 / math.sqrt(27 * module.in_channels)
                for parameter in module.parameters():
                    nn.init.uniform_(parameter, -bound, bound, generator=generator)
        for block in (*self.input_blocks, *self.out_blocks):
            start_at_zero(block.conv2)

    def forward(self, x: SparseTensor, t: Tensor, cond: Tensor) -> SparseTensor:
        """Velocities (T, out_channels), in the dtype of `x`, of normalised latents of B samples.

        Args:
            x: (T, in_channels) voxels at times t.
            t, cond: see `modulation`.
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
