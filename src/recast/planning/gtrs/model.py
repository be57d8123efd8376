"""GTRS-Dense: an image, the ego status and trajectories in, scores per trajectory out."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from recast.planning.gtrs.attention import BiasedAttention
from recast.planning.gtrs.config import GtrsConfig
from recast.planning.gtrs.head import TrajectoryHead
from recast.planning.gtrs.vovnet import VovNet

STATUS_VALUES = 8


class PositionEmbedding(nn.Module):
    """One learned vector for each image token.

    Not an `nn.Embedding`: on the meta device its initial values make PyTorch import a computer
    algebra system, which takes longer than all the rest of loading a small model.
    """

    def __init__(self, tokens: int, channels: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(tokens, channels))

    def forward(self, tokens: Tensor) -> Tensor:
        """(B, T, d) with the vectors added."""
        return tokens + self.weight


class GtrsModel(nn.Module):
    """The network. Its parameters are named as in the released checkpoints.

    The vocabulary is an argument, not a parameter: any set of trajectories can be scored. Modules
    that the released checkpoints hold but never use (agent head, query embedding) do not exist.

    Source: Li et al., "Generalized Trajectory Scoring for End-to-end Multimodal Planning" (2025).

    Args:
        config: sizes; kept as `config`.
    """

    def __init__(self, config: GtrsConfig) -> None:
        super().__init__()
        self.config = config
        self._backbone = nn.ModuleDict({"image_encoder": VovNet(config.backbone)})
        self._keyval_embedding = PositionEmbedding(config.image_tokens, config.channels)
        self.downscale_layer = nn.Conv2d(config.backbone.out_channels, config.channels, 1)
        self._status_encoding = nn.Linear(STATUS_VALUES, config.channels)
        self._trajectory_head = TrajectoryHead(config)

    @property
    def backbone(self) -> VovNet:
        """The image encoder."""
        encoder = self._backbone["image_encoder"]
        assert isinstance(encoder, VovNet)
        return encoder

    @property
    def head(self) -> TrajectoryHead:
        """The trajectory head."""
        return self._trajectory_head

    @property
    def device(self) -> torch.device:
        """Where the parameters live."""
        return self.downscale_layer.weight.device

    def image_tokens(self, features: Tensor) -> Tensor:
        """Backbone features (B, C, h, w) to tokens (B, T, d), row by row."""
        config = self.config
        pooled = functional.adaptive_avg_pool2d(features, (config.token_rows, config.token_columns))
        tokens: Tensor = self.downscale_layer(pooled).flatten(2).transpose(1, 2)
        out: Tensor = self._keyval_embedding(tokens)
        return out

    def encode_status(self, status: Tensor) -> Tensor:
        """Ego status (B, 8), see `ego_status`, to (B, d)."""
        out: Tensor = self._status_encoding(status)
        return out

    def score(self, features: Tensor, status: Tensor, trajectories: Tensor) -> dict[str, Tensor]:
        """Logits from backbone features (B, C, h, w); otherwise as `forward`."""
        if trajectories.ndim == 3:
            trajectories = trajectories[None]
        return self._trajectory_head(
            trajectories, self.image_tokens(features), self.encode_status(status)
        )

    def forward(self, images: Tensor, status: Tensor, trajectories: Tensor) -> dict[str, Tensor]:
        """Logits of every head for every trajectory.

        Args:
            images: (B, 3, H, W) stitched, RGB in [0, 1].
            status: (B, 8), see `ego_status`.
            trajectories: (L, 40, 3), the same for all samples, or (B, L, 40, 3): x, y, heading of
                the rear axle in the present ego frame at 0.1 s .. 4 s.

        Returns:
            head name to (B, L); see `final_score`.
        """
        return self.score(self.backbone(images), status, trajectories)

    @torch.no_grad()
    def initialise(self, generator: torch.Generator) -> None:
        """Draw initial weights, for training from scratch.

        Convolutions He-normal, linear layers and attention Xavier-uniform, biases 0, norms the
        identity, the positional embedding N(0, 0.02).

        Args:
            generator: on the model's device; source of all random numbers.
        """
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu", generator=generator)
            elif isinstance(module, nn.Linear):
                nn.init.xavier_uniform_(module.weight, generator=generator)
            elif isinstance(module, BiasedAttention):
                nn.init.xavier_uniform_(module.in_proj_weight, generator=generator)
                nn.init.zeros_(module.in_proj_bias)
            elif isinstance(module, PositionEmbedding):
                nn.init.normal_(module.weight, std=0.02, generator=generator)
            elif isinstance(module, nn.BatchNorm2d | nn.LayerNorm):
                module.reset_parameters()
            if isinstance(module, nn.Conv2d | nn.Linear) and module.bias is not None:
                nn.init.zeros_(module.bias)


def new_model(
    config: GtrsConfig, generator: torch.Generator, device: str | torch.device = "cpu"
) -> GtrsModel:
    """A model with initial weights, in evaluation mode; see `GtrsModel.initialise`."""
    model = empty_model(config).to_empty(device=device)
    model.initialise(generator)
    return model.eval()


def empty_model(config: GtrsConfig) -> GtrsModel:
    """A model on the meta device: names and shapes, no memory, no random numbers drawn."""
    with torch.device("meta"):
        return GtrsModel(config)
