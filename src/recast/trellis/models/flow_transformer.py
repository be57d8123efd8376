"""What both flow transformers share: arguments, time and image modulation, blocks."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from recast.trellis.layers import ModulatedCrossBlock, TimestepEmbedder, modulation_layer
from recast.trellis.models.base import Size, TransformerConfig, TrellisModel, start_at_zero


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
    """Base of the flow transformers; a subclass appends its input, `blocks` and output.

    Args:
        config: constructor arguments.
    """

    config: FlowConfig

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
        """As the base; the shared modulation starts at zero."""
        super().initialise(generator)
        if self.adaLN_modulation is not None:
            start_at_zero(self.adaLN_modulation)

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
