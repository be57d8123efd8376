"""The trajectory head: vocabulary encoder, decoder and one score head per metric."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from recast.planning.gtrs.attention import Decoder, EncoderLayer
from recast.planning.gtrs.cache import TensorCache
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
            nn.Linear(d, hidden), nn.ReLU(),
            nn.Linear(hidden, hidden), nn.ReLU(),
            nn.Linear(hidden, 1),
        )  # fmt: skip
        self._cache = TensorCache()

    def embed(self, trajectories: Tensor) -> Tensor:
        """(N, L, 40, 3) in metres and radians, x0 y0 h0 x1 ..., to tokens (N, L, d)."""
        out: Tensor = self.pos_embed(trajectories.flatten(-2))
        return out

    def encode(self, trajectories: Tensor) -> Tensor:
        """(N, L, 40, 3) to tokens (N, L, d) that have seen each other once."""
        out: Tensor = self.encoder(self.embed(trajectories))
        return out

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
        out: Tensor = self.transformer(prepared.expand(len(image_tokens), -1, -1), image_tokens)
        return out

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
