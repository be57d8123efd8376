"""Residual block of submanifold convolutions, modulated by the time embedding."""

from __future__ import annotations

from torch import Tensor, nn
from torch.nn.functional import silu

from recast.trellis.layers import LayerNorm32
from recast.trellis.sparse import PackedTokens, PoolIndex, SparseTensor, SubMConv3d, unpool


class SparseResBlock3d(nn.Module):
    """Two 3x3x3 submanifold convolutions around a scale and shift by the time.

        h = conv1(silu(norm1(x)));  h = norm2(h) * (1 + scale) + shift
        out = conv2(silu(h)) + skip(x)

    The linear layer of the time embedding gives scale first, then shift: the reverse of the
    transformer blocks' order.

    Args:
        in_channels: channels of the input.
        emb_channels: channels of the time embedding.
        out_channels: channels of the output; where they differ from the input's, the skip
            connection is linear.
    """

    def __init__(self, in_channels: int, emb_channels: int, out_channels: int) -> None:
        super().__init__()
        self.norm1 = LayerNorm32(in_channels, affine=True)
        self.norm2 = LayerNorm32(out_channels, affine=False)
        self.conv1 = SubMConv3d(in_channels, out_channels)
        self.conv2 = SubMConv3d(out_channels, out_channels)
        self.emb_layers = nn.Sequential(nn.SiLU(), nn.Linear(emb_channels, 2 * out_channels))
        self.skip_connection: nn.Module = (
            nn.Linear(in_channels, out_channels) if in_channels != out_channels else nn.Identity()
        )

    def forward(
        self, x: SparseTensor, t_emb: Tensor, index: PoolIndex | None = None
    ) -> SparseTensor:
        """One block.

        Args:
            x: (T, in_channels) voxels.
            t_emb: (B, emb_channels) time embedding of each sample.
            index: makes this an upsampling block: `x` lives on the pooled voxels and is taken to
                those that `index` was made from. The norm and the skip connection treat every row
                alone and unpooling copies rows, so they run before it, on few rows, to the same
                effect.

        Returns:
            (T, out_channels) voxels, on the fine grid where `index` is given.
        """
        skip = x.with_feats(self.skip_connection(x.feats))
        h = x.with_feats(silu(self.norm1(x.feats)))
        if index is not None:
            h, skip = unpool(h, index), unpool(skip, index)
        h = self.conv1(h)
        layout = PackedTokens(h)
        scale, shift = (layout.spread(part) for part in self.emb_layers(t_emb).chunk(2, dim=1))
        h = self.conv2(h.with_feats(silu(self.norm2(h.feats) * (1 + scale) + shift)))
        return h.with_feats(h.feats + skip.feats)
