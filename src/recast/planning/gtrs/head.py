"""The trajectory head: vocabulary encoder, decoder and one score head per metric.

Its transformer layers are post-norm; all attention is scaled dot-product attention. Parameters are
named as in the released checkpoints: those of the decoder are PyTorch's
`nn.TransformerDecoderLayer`, whose own evaluation path may build the whole score matrix (2 GB for
8192 trajectories).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from recast.planning.gtrs.config import GtrsConfig
from recast.planning.types import WAYPOINTS

METRICS = (
    "no_at_fault_collisions",
    "drivable_area_compliance",
    "time_to_collision_within_bound",
    "ego_progress",
    "driving_direction_compliance",
    "lane_keeping",
    "traffic_light_compliance",
)
"""Heads whose sigmoid is the expected sub-score of a trajectory."""

IMITATION = "imi"
"""Head whose softmax over the vocabulary is the probability that a human drives a trajectory."""

HEADS = (*METRICS, IMITATION)


class TrajectoryHead(nn.Module):
    """Scores trajectories against image tokens. Parameter names are those of the release."""

    def __init__(self, config: GtrsConfig) -> None:
        super().__init__()
        d, hidden = config.channels, config.feedforward
        self.pos_embed = nn.Sequential(
            nn.Linear(3 * WAYPOINTS, hidden), nn.ReLU(), nn.Linear(hidden, d)
        )
        self.encoder = EncoderLayer(d, config.heads)
        self.transformer = Decoder(d, config.heads, hidden, config.decoder_layers)
        self.heads = nn.ModuleDict(
            {
                name: nn.Sequential(nn.Linear(d, hidden), nn.ReLU(), nn.Linear(hidden, 1))
                for name in METRICS
            }
        )
        self.heads[IMITATION] = nn.Sequential(
            nn.Linear(d, hidden),
            nn.ReLU(),
            nn.Linear(hidden, hidden),
            nn.ReLU(),
            nn.Linear(hidden, 1),
        )
        self._cache = TensorCache()

    def embed(self, trajectories: Tensor) -> Tensor:
        """(N, L, 40, 3) in metres and radians, x0 y0 h0 x1 ..., to tokens (N, L, d)."""
        return self.pos_embed(trajectories.flatten(-2))

    def encode(self, trajectories: Tensor) -> Tensor:
        """(N, L, 40, 3) to tokens (N, L, d) that have seen each other once."""
        return self.encoder(self.embed(trajectories))

    def prepare(self, trajectories: Tensor) -> Tensor:
        """(N, L, 40, 3) to tokens (N, L, d) before the first look at the image; never cached."""
        return self.transformer.first.look_at_each_other(self.encode(trajectories))

    def prepare_cached(self, trajectories: Tensor) -> Tensor:
        """What `prepare` gives, kept until the trajectories or the weights it uses change.

        With gradients, or under autocast, it is always computed.
        """
        if torch.is_grad_enabled() or torch.is_autocast_enabled(trajectories.device.type):
            return self.prepare(trajectories)
        first = self.transformer.first
        parts = (self.pos_embed, self.encoder, first.self_attn, first.norm1)
        weights = [parameter for part in parts for parameter in part.parameters()]
        return self._cache.get([trajectories, *weights], lambda: self.prepare(trajectories))

    def decode(self, prepared: Tensor, image_tokens: Tensor) -> Tensor:
        """Tokens (N, L, d) of `prepare` and image tokens (B, T, d) to (B, L, d); N is 1 or B."""
        return self.transformer(prepared.expand(len(image_tokens), -1, -1), image_tokens)

    def logits(self, tokens: Tensor) -> dict[str, Tensor]:
        """Tokens (B, L, d) to logits (B, L) by head."""
        return {name: head(tokens).squeeze(-1) for name, head in self.heads.items()}

    def forward(
        self, trajectories: Tensor, image_tokens: Tensor, status_code: Tensor
    ) -> dict[str, Tensor]:
        """Logits (B, L) by head.

        Args:
            trajectories: (N, L, 40, 3), N being 1 (the same for all samples, see
                `prepare_cached`) or B.
            image_tokens: (B, T, d).
            status_code: (B, d), added to every token after the decoder.
        """
        shared = len(trajectories) == 1
        prepared = self.prepare_cached(trajectories) if shared else self.prepare(trajectories)
        return self.logits(self.decode(prepared, image_tokens) + status_code[:, None])


def attend(q: Tensor, k: Tensor, v: Tensor, heads: int) -> Tensor:
    """Multi-head attention of (B, Q, d) queries to (B, K, d) keys and values; scale 1/sqrt(d/H)."""
    q, k, v = (x.unflatten(-1, (heads, -1)).transpose(-2, -3) for x in (q, k, v))
    return functional.scaled_dot_product_attention(q, k, v).transpose(-2, -3).flatten(-2)


class BiasedAttention(nn.Module):
    """Attention with the parameters of `nn.MultiheadAttention`."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.in_proj_weight = nn.Parameter(torch.empty(3 * channels, channels))
        self.in_proj_bias = nn.Parameter(torch.empty(3 * channels))
        self.out_proj = nn.Linear(channels, channels)

    def forward(self, queries: Tensor, context: Tensor) -> Tensor:
        """Queries (B, Q, d) and context (B, K, d) to (B, Q, d)."""
        d = queries.shape[-1]
        q = functional.linear(queries, self.in_proj_weight[:d], self.in_proj_bias[:d])
        k, v = functional.linear(context, self.in_proj_weight[d:], self.in_proj_bias[d:]).chunk(
            2, dim=-1
        )
        return self.out_proj(attend(q, k, v, self.heads))


class UnbiasedAttention(nn.Module):
    """Self-attention with four projections without bias."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.to_q = nn.Linear(channels, channels, bias=False)
        self.to_k = nn.Linear(channels, channels, bias=False)
        self.to_v = nn.Linear(channels, channels, bias=False)
        self.to_out = nn.Linear(channels, channels, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        """(B, L, d) to (B, L, d)."""
        return self.to_out(attend(self.to_q(x), self.to_k(x), self.to_v(x), self.heads))


class EncoderLayer(nn.Module):
    """The trajectories of a vocabulary attend to one another."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.self_attn = UnbiasedAttention(channels, heads)
        self.linear1 = nn.Linear(channels, 4 * channels)
        self.linear2 = nn.Linear(4 * channels, channels)
        self.norm1 = nn.LayerNorm(channels)
        self.norm3 = nn.LayerNorm(channels)  # there is no second one, nor was there in the release

    def forward(self, x: Tensor) -> Tensor:
        """(B, L, d) to (B, L, d)."""
        x = self.norm1(x + self.self_attn(x))
        return self.norm3(x + self.linear2(functional.relu(self.linear1(x))))


class DecoderLayer(nn.Module):
    """Self-attention, cross-attention to the image, feed-forward; in two callable halves."""

    def __init__(self, channels: int, heads: int, feedforward: int) -> None:
        super().__init__()
        self.self_attn = BiasedAttention(channels, heads)
        self.multihead_attn = BiasedAttention(channels, heads)
        self.linear1 = nn.Linear(channels, feedforward)
        self.linear2 = nn.Linear(feedforward, channels)
        self.norm1 = nn.LayerNorm(channels)
        self.norm2 = nn.LayerNorm(channels)
        self.norm3 = nn.LayerNorm(channels)

    def look_at_each_other(self, x: Tensor) -> Tensor:
        """Self-attention and first norm, (B, L, d): all of the layer that needs no image."""
        return self.norm1(x + self.self_attn(x, x))

    def look_at_image(self, x: Tensor, image_tokens: Tensor) -> Tensor:
        """The rest of the layer: (B, L, d) and image tokens (B, T, d) to (B, L, d)."""
        x = self.norm2(x + self.multihead_attn(x, image_tokens))
        return self.norm3(x + self.linear2(functional.relu(self.linear1(x))))

    def forward(self, x: Tensor, image_tokens: Tensor) -> Tensor:
        """The whole layer: (B, L, d) and image tokens (B, T, d) to (B, L, d)."""
        return self.look_at_image(self.look_at_each_other(x), image_tokens)


class Decoder(nn.Module):
    """A stack of decoder layers."""

    def __init__(self, channels: int, heads: int, feedforward: int, layers: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList(
            DecoderLayer(channels, heads, feedforward) for _ in range(layers)
        )

    @property
    def first(self) -> DecoderLayer:
        """The layer whose self-attention sees nothing but the vocabulary."""
        layer = self.layers[0]
        assert isinstance(layer, DecoderLayer)
        return layer

    def forward(self, x: Tensor, image_tokens: Tensor) -> Tensor:
        """All layers but the first one's self-attention, which `x` has been through."""
        x = self.first.look_at_image(x, image_tokens)
        for layer in self.layers[1:]:
            x = layer(x, image_tokens)
        return x


class TensorCache:
    """The last result of a pure function of tensors.

    The inputs are compared by value with copies of their own. That costs one pass over them, and
    cannot miss a change, however it was made: an optimiser step, new weights, writing in place.
    """

    def __init__(self) -> None:
        self._inputs: list[Tensor] = []
        self._result: Tensor | None = None

    def get(self, inputs: Sequence[Tensor], compute: Callable[[], Tensor]) -> Tensor:
        """The kept result if `inputs` are as they were, else that of `compute`.

        Args:
            compute: gives a tensor that nobody writes to.
        """
        if self._result is None or not self._unchanged(inputs):
            # Forgotten first, so that a failing computation leaves nothing that looks valid.
            self._result = None
            result = compute().detach()
            self._inputs = [tensor.detach().clone() for tensor in inputs]
            self._result = result
        return self._result

    def _unchanged(self, inputs: Sequence[Tensor]) -> bool:
        return len(inputs) == len(self._inputs) and all(
            ours.device == theirs.device
            and ours.dtype == theirs.dtype
            and torch.equal(ours, theirs)
            for ours, theirs in zip(self._inputs, inputs, strict=True)
        )
