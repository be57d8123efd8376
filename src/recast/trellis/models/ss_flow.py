"""Flow transformer of the sparse structure: velocity of a dense latent grid, given an image."""

from __future__ import annotations

from typing import ClassVar, Self

import torch
from pydantic import model_validator
from torch import Tensor, nn

from recast.trellis.layers import (
    DenseTokens,
    absolute_positions,
    final_norm,
)
from recast.trellis.models.base import ModelConfig, Size, start_at_zero
from recast.trellis.models.flow_transformer import FlowConfig, FlowTransformer


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
        """As the base, and zero output: a new model predicts no velocity."""
        super().initialise(generator)
        along = torch.arange(self.config.resolution // self.config.patch_size)
        coords = torch.cartesian_prod(along, along, along)
        self.pos_emb.copy_(absolute_positions(coords, self.config.model_channels))
        start_at_zero(self.out_layer)

    def forward(self, x: Tensor, t: Tensor, cond: Tensor) -> Tensor:
        """Velocity of the flow.

        Args:
            x: (B, in_channels, R, R, R) latents at time t.
            t: (B,) times, already multiplied by 1000.
            cond: (B, L, cond_channels) image tokens.

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
