"""GTRS-Dense: an image, the ego status and trajectories in, scores per trajectory out.

Its transformer layers are post-norm; all attention is scaled dot-product attention. Parameters are
named as in the released checkpoints: those of the decoder are PyTorch's
`nn.TransformerDecoderLayer`, whose own evaluation path may build the whole score matrix (2 GB for
8192 trajectories).

The image backbone is VoVNetV2 with effective squeeze-excitation in every block. Its module names,
with their slashes, are those of the released checkpoints. They differ from timm's `ese_vovnet`,
which has the eSE in the last block of each stage only and is not equivalent.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from recast.planning.gtrs.config import BackboneConfig, GtrsConfig
from recast.planning.gtrs.perception import ColumnTokens, Foresight, PositionEmbedding
from recast.planning.gtrs.scores import IMITATION, METRICS
from recast.planning.types import WAYPOINTS


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
        self,
        trajectories: Tensor,
        image_tokens: Tensor,
        status_code: Tensor,
        foreseen: Tensor | None = None,
    ) -> dict[str, Tensor]:
        """Logits (B, L) by head.

        Args:
            trajectories: (N, L, 40, 3), N being 1 (the same for all samples, see
                `prepare_cached`) or B.
            image_tokens: (B, T, d).
            status_code: (B, d), added to every token after the decoder.
            foreseen: (B, L, d), added to each, see `Foresight`.
        """
        shared = len(trajectories) == 1
        prepared = self.prepare_cached(trajectories) if shared else self.prepare(trajectories)
        tokens = self.decode(prepared, image_tokens) + status_code[:, None]
        return self.logits(tokens if foreseen is None else tokens + foreseen)


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


STATUS_VALUES = 8


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
        self._columns = self._foresight = None
        if config.history is not None:
            self._columns = ColumnTokens(config)
            self._foresight = Foresight(config.channels, config.image_tokens, config.token_columns)

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
    def foresight(self) -> Foresight:
        """What reads the image in metres; only of a model with a history."""
        assert self._foresight is not None
        return self._foresight

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

    def look(
        self, features: Tensor, earlier: Tensor | None = None, age: Tensor | None = None
    ) -> Tensor:
        """What trajectories are scored against, (B, T, d): the image's tokens, and, for a model
        with a history, those of its columns.

        Args:
            features: backbone features (B, C, h, w).
            earlier: those of earlier images.
            age: (B,) how much earlier, seconds; 0 where there is none. None: the history.
        """
        tokens = self.image_tokens(features)
        if self._columns is None:
            return tokens
        before = None if earlier is None else self.image_tokens(earlier)
        columns = self._columns(tokens, before, age, self.foresight.stands)
        return torch.cat([tokens, columns], dim=1)

    def score(self, tokens: Tensor, status: Tensor, trajectories: Tensor) -> dict[str, Tensor]:
        """Logits from the tokens of `look`; otherwise as `forward`."""
        if trajectories.ndim == 3:
            trajectories = trajectories[None]
        code, foreseen = self.encode_status(status), None
        if self._foresight is not None:
            foreseen = self._foresight(tokens, status, trajectories)
        return self._trajectory_head(trajectories, tokens, code, foreseen)

    def forward(
        self,
        images: Tensor,
        status: Tensor,
        trajectories: Tensor,
        earlier: Tensor | None = None,
        age: Tensor | None = None,
    ) -> dict[str, Tensor]:
        """Logits of every head for every trajectory; arguments beside these as of `look`.

        Args:
            images: (B, 3, H, W) stitched, RGB in [0, 1].
            status: (B, 8), see `ego_status`.
            trajectories: (L, 40, 3), the same for all samples, or (B, L, 40, 3): x, y, heading of
                the rear axle in the present ego frame at 0.1 s .. 4 s.
            earlier: (B, 3, H, W) images, for a model that looks at them; None: there are none.

        Returns:
            head name to (B, L); see `final_score`.
        """
        before = None if earlier is None else self.backbone(earlier)
        tokens = self.look(self.backbone(images), before, age)
        return self.score(tokens, status, trajectories)

    @torch.no_grad()
    def initialise(self, generator: torch.Generator) -> None:
        """Draw initial weights, for training from scratch.

        Convolutions He-normal, linear layers and attention Xavier-uniform, biases 0, norms the
        identity, the positional embedding N(0, 0.02).

        Args:
            generator: random generator on the model's device; source of all random numbers.
        """
        for module in self.modules():
            if isinstance(module, nn.Conv1d | nn.Conv2d):
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
            elif isinstance(module, Foresight):
                module.directions.copy_(torch.linspace(1.0, -1.0, len(module.directions)))
            if isinstance(module, nn.Conv1d | nn.Conv2d | nn.Linear) and module.bias is not None:
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

    The folded weights are computed anew each time, which costs nothing beside the convolution: so
    there is one set of weights, and nothing that could be out of date.
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
