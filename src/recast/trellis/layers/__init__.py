"""Layers of the TRELLIS transformers, the same for dense, sparse and windowed tokens."""

from recast.trellis.layers.attention import CrossAttention, SelfAttention
from recast.trellis.layers.blocks import (
    FeedForward,
    ModulatedCrossBlock,
    TransformerBlock,
    modulation_layer,
)
from recast.trellis.layers.embedding import (
    TimestepEmbedder,
    absolute_positions,
    timestep_embedding,
)
from recast.trellis.layers.layout import DenseTokens, TokenLayout
from recast.trellis.layers.norm import (
    ChannelLayerNorm32,
    LayerNorm32,
    MultiHeadRmsNorm,
    final_norm,
)

__all__ = [
    "ChannelLayerNorm32",
    "CrossAttention",
    "DenseTokens",
    "FeedForward",
    "LayerNorm32",
    "ModulatedCrossBlock",
    "MultiHeadRmsNorm",
    "SelfAttention",
    "TimestepEmbedder",
    "TokenLayout",
    "TransformerBlock",
    "absolute_positions",
    "final_norm",
    "modulation_layer",
    "timestep_embedding",
]
