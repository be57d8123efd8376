"""What encoder and decoder of the structured latents share: a sparse windowed transformer."""

from __future__ import annotations

from typing import ClassVar, Literal

import torch
from torch import Tensor, nn

from recast.trellis.layers import TransformerBlock, absolute_positions, final_norm
from recast.trellis.models.base import Size, TransformerConfig, TrellisModel, start_at_zero
from recast.trellis.sparse import SparseTensor, WindowedTokens


class SLatVaeConfig(TransformerConfig):
    """Arguments that `SLatEncoder` and `SLatGaussianDecoder` share.

    Args:
        resolution: R, voxels along an edge of the unit cube.
        latent_channels: channels of the latent of a voxel.
        attn_mode: attention in windows, the only mode of the published models.
        window_size: edge of a window in voxels; every other block is shifted by half of it.
    """

    resolution: Size
    latent_channels: Size
    attn_mode: Literal["swin"] = "swin"
    window_size: Size = 8


class SLatTransformer(TrellisModel):
    """Transformer over voxels with attention in windows, half a window apart in every other block.

    Args:
        config: constructor arguments.
        in_channels: features of a voxel.
        out_channels: outputs of a voxel.
    """

    torso: ClassVar[tuple[str, ...]] = ("blocks",)
    config: SLatVaeConfig

    def __init__(self, config: SLatVaeConfig, in_channels: int, out_channels: int) -> None:
        super().__init__(config)
        c = config.model_channels
        self.input_layer = nn.Linear(in_channels, c)
        self.blocks = nn.ModuleList(
            TransformerBlock(c, config.heads, config.mlp_ratio, config.qk_rms_norm)
            for _ in range(config.num_blocks)
        )
        self.out_layer = nn.Linear(c, out_channels)

    @torch.no_grad()
    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw initial weights; the output starts at zero."""
        super().initialise(generator)
        start_at_zero(self.out_layer)

    def outputs(self, x: SparseTensor) -> Tensor:
        """Features (T, in_channels) of the voxels to (T, out_channels), in the dtype of `x`."""
        h = self.input_layer(x.feats)
        h = h + absolute_positions(x.coords[:, 1:], h.shape[1])
        h = h.to(self.torso_dtype)
        window = self.config.window_size
        layouts = [WindowedTokens(x, window, shift) for shift in (0, window // 2)]
        for i, block in enumerate(self.blocks):
            h = self.run_block(block, h, layouts[i % 2])
        out: Tensor = self.out_layer(final_norm(h.to(x.feats.dtype)))
        return out
