"""GTRS-Dense: an image, the ego status and trajectories in, scores per trajectory out.

The image backbone is VoVNetV2 with effective squeeze-excitation in every block. Its module names,
with their slashes, are those of the released checkpoints. They differ from timm's `ese_vovnet`,
which has the eSE in the last block of each stage only and is not equivalent.
"""

from __future__ import annotations

from collections import OrderedDict

import torch
from torch import Tensor, nn
from torch.nn import functional

from recast.planning.gtrs.config import BackboneConfig, GtrsConfig
from recast.planning.gtrs.head import BiasedAttention, TrajectoryHead

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
        return self._keyval_embedding(tokens)

    def encode_status(self, status: Tensor) -> Tensor:
        """Ego status (B, 8), see `ego_status`, to (B, d)."""
        return self._status_encoding(status)

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
            generator: random generator on the model's device; source of all random numbers.
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


class _FrozenBatchNorm(nn.BatchNorm2d):
    """A batch norm that always uses its running statistics; scale and shift are trainable."""

    def train(self, mode: bool = True) -> _FrozenBatchNorm:
        return super().train(False)


class _Chain(nn.Sequential):
    """Modules one after the other; in inference, a norm is folded into the convolution before it.

    That saves two passes over the features. The folded weights are computed anew each time, which
    costs nothing beside the convolution: so there is one set of weights, to be trained, saved and
    replaced, and nothing that could be out of date.
    """

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to what the last module gives."""
        modules = list(self)
        if torch.is_grad_enabled() or any(module.training for module in modules):
            for module in modules:
                x = module(x)
            return x
        for module, following in zip(modules, [*modules[1:], None], strict=True):
            if isinstance(module, nn.Conv2d) and isinstance(following, nn.BatchNorm2d):
                x = _folded(module, following, x)
            elif isinstance(module, nn.ReLU):
                x = x.relu_()  # always behind a convolution, whose output nobody else holds
            elif not isinstance(module, nn.BatchNorm2d):
                x = module(x)
        return x


def _folded(conv: nn.Conv2d, norm: nn.BatchNorm2d, x: Tensor) -> Tensor:
    """`norm(conv(x))` with running statistics, as one convolution."""
    assert norm.running_mean is not None and norm.running_var is not None
    scale = norm.weight * torch.rsqrt(norm.running_var + norm.eps)
    shift = norm.bias - norm.running_mean * scale
    weight = conv.weight * scale[:, None, None, None]
    return functional.conv2d(x, weight, shift, conv.stride, conv.padding)


class _Blocks:
    """Builds the convolutions of one backbone."""

    def __init__(self, frozen_norm: bool) -> None:
        self.norm: type[nn.BatchNorm2d] = _FrozenBatchNorm if frozen_norm else nn.BatchNorm2d

    def conv(self, name: str, inputs: int, outputs: int, kernel: int, stride: int = 1) -> nn.Module:
        """Convolution, batch norm and ReLU as `<name>/conv`, `<name>/norm`, `<name>/relu`."""
        parts: OrderedDict[str, nn.Module] = OrderedDict()
        parts[f"{name}/conv"] = nn.Conv2d(
            inputs, outputs, kernel, stride, padding=kernel // 2, bias=False
        )
        parts[f"{name}/norm"] = self.norm(outputs)
        parts[f"{name}/relu"] = nn.ReLU()
        return _Chain(parts)


class EffectiveSqueezeExcitation(nn.Module):
    """Channel weights from the mean over the image: y * relu6(fc(mean y) + 3) / 6."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.fc = nn.Conv2d(channels, channels, 1)

    def forward(self, y: Tensor) -> Tensor:
        """(B, C, H, W) to the same shape."""
        return y * functional.hardsigmoid(self.fc(y.mean((2, 3), keepdim=True)))


class AggregationBlock(nn.Module):
    """One-shot aggregation: a chain of 3x3 convolutions, all kept, mixed once by a 1x1."""

    def __init__(
        self,
        build: _Blocks,
        name: str,
        inputs: int,
        channels: int,
        outputs: int,
        layers: int,
        residual: bool,
    ) -> None:
        super().__init__()
        self.residual = residual
        self.layers = nn.ModuleList(
            build.conv(f"{name}_{i}", channels if i else inputs, channels, 3) for i in range(layers)
        )
        self.concat = build.conv(f"{name}_concat", inputs + layers * channels, outputs, 1)
        self.ese = EffectiveSqueezeExcitation(outputs)

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, H, W) to (B, outputs, H, W)."""
        features = [x]
        for layer in self.layers:
            features.append(layer(features[-1]))
        y: Tensor = self.ese(self.concat(torch.cat(features, dim=1)))
        return y + x if self.residual else y


class VovNet(nn.Module):
    """The backbone of a `BackboneConfig`.

    Source: Lee and Park, CenterMask (2020), as used by GTRS: eSE in every block, all blocks of a
    stage but the first residual, pools 3x3 of stride 2 without padding that round up.
    """

    def __init__(self, config: BackboneConfig) -> None:
        super().__init__()
        build = _Blocks(config.frozen_norm)
        stem, inputs = OrderedDict[str, nn.Module](), 3
        for i, (channels, stride) in enumerate(zip(config.stem, (2, 1, 2), strict=True), start=1):
            stem.update(build.conv(f"stem_{i}", inputs, channels, 3, stride).named_children())
            inputs = channels
        self.stem = _Chain(stem)
        self.stage_names: list[str] = []
        for number, stage in enumerate(config.stages, start=2):
            parts = OrderedDict[str, nn.Module]()
            if number > 2:
                parts["Pooling"] = nn.MaxPool2d(3, 2, ceil_mode=True)
            for block in range(1, stage.blocks + 1):
                name = f"OSA{number}_{block}"
                parts[name] = AggregationBlock(
                    build,
                    name,
                    inputs,
                    stage.conv_channels,
                    stage.out_channels,
                    config.layers,
                    residual=block > 1,
                )
                inputs = stage.out_channels
            self.stage_names.append(f"stage{number}")
            self.add_module(f"stage{number}", nn.Sequential(parts))

    def stages(self, images: Tensor) -> list[Tensor]:
        """Features of every stage, finest first.

        Args:
            images: (B, 3, H, W) RGB in [0, 1], not normalised.

        Returns:
            tensors (B, C_s, H_s, W_s) at strides 4, 8, ...; the pools round sizes up.
        """
        x = self.stem(images.flip(1))  # the weights were trained on BGR
        features = []
        for name in self.stage_names:
            x = self.get_submodule(name)(x)
            features.append(x)
        return features

    def forward(self, images: Tensor) -> Tensor:
        """(B, 3, H, W) RGB in [0, 1] to the last stage's features; see `stages`."""
        return self.stages(images)[-1]
