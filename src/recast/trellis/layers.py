"""Layers of the networks: attention, transformer blocks, and the base class of all models."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, Protocol, Self

import torch
from pydantic import ConfigDict, Field, model_validator
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.functional import silu
from torch.utils.checkpoint import checkpoint

from recast.core.records import Record
from recast.trellis.sparse import PackedTokens, PoolIndex, SparseTensor, attention, unpool
from recast.trellis.sparse_convolution import SubMConv3d


class TokenLayout(Protocol):
    """How tokens (..., C) fall into samples, and which of them attend to which.

    The layers know nothing else about their tokens, so one set of modules serves the dense tokens
    of the sparse structure, (B, N, C), and the packed or windowed tokens of voxels, (T, C).
    """

    def spread(self, per_sample: Tensor) -> Tensor:
        """Values (B, C) of the samples in a shape that broadcasts against the tokens."""
        ...

    def attend(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """Self-attention, all of them (..., H, D): softmax(q k^T / sqrt(D)) v within a group."""
        ...

    def attend_to(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """Attention of queries (..., H, D) to their sample's context: k, v (B, L, H, D)."""
        ...


class DenseTokens:
    """Tokens (B, N, C): every token of a sample attends to all tokens of that sample."""

    def spread(self, per_sample: Tensor) -> Tensor:
        """(B, C) to (B, 1, C)."""
        return per_sample.unsqueeze(1)

    def attend(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """Attention of (B, N, H, D) to all tokens (B, L, H, D) of the sample."""
        return attention(q, k, v)

    attend_to = attend


class LayerNorm32(nn.LayerNorm):
    """Layer normalisation over the last axis, computed in float32.

    Its weights stay float32 in a half-precision torso. Without `affine` it has no parameters, so
    no names in a checkpoint.

    Args:
        channels: length of the last axis.
        affine: learn a weight and a bias.
        eps: number added to the variance; 1e-6 in transformer and sparse residual blocks.
    """

    def __init__(self, channels: int, affine: bool, eps: float = 1e-6) -> None:
        super().__init__(channels, eps=eps, elementwise_affine=affine)

    def forward(self, x: Tensor) -> Tensor:
        """Tensor (..., channels) to the same shape and dtype."""
        return super().forward(x.float()).to(x.dtype)


class ChannelLayerNorm32(LayerNorm32):
    """Layer normalisation over the channels of each voxel of a dense grid, with affine weights.

    Its epsilon is 1e-5, unlike that of the transformer blocks.
    """

    def __init__(self, channels: int) -> None:
        super().__init__(channels, affine=True, eps=1e-5)

    def forward(self, x: Tensor) -> Tensor:
        """Grid (B, channels, X, Y, Z) to the same shape and dtype, channels last in memory."""
        return super().forward(x.movedim(1, -1)).movedim(-1, 1)


class MultiHeadRmsNorm(nn.Module):
    """Per-head normalisation of queries or keys: x / max(|x|, 1e-12) * gamma * sqrt(D).

    An L2 normalisation rather than the usual RMS norm: there is no epsilon inside the mean.
    `gamma` is (H, D), heads by channels of a head, float32 in every torso.
    """

    def __init__(self, head_channels: int, heads: int) -> None:
        super().__init__()
        self.scale = math.sqrt(head_channels)
        self.gamma = nn.Parameter(torch.ones(heads, head_channels))

    def forward(self, x: Tensor) -> Tensor:
        """Tensor (..., H, D) to the same shape and dtype."""
        return (functional.normalize(x.float(), dim=-1) * self.gamma * self.scale).to(x.dtype)


def final_norm(h: Tensor) -> Tensor:
    """Normalisation before an output layer: over the last axis, no affine, eps 1e-5.

    Runs in the dtype it is given; the caller decides whether to leave half precision before.
    """
    return functional.layer_norm(h, h.shape[-1:])


class _HeadNorms(nn.Module):
    """Heads of self- and cross-attention, and their optional normalisation."""

    def __init__(self, channels: int, heads: int, qk_rms_norm: bool) -> None:
        super().__init__()
        if channels % heads:
            raise ValueError(f"{channels} channels do not divide into {heads} heads")
        self.heads = heads
        self.qk_rms_norm = qk_rms_norm
        if qk_rms_norm:
            self.q_rms_norm = MultiHeadRmsNorm(channels // heads, heads)
            self.k_rms_norm = MultiHeadRmsNorm(channels // heads, heads)

    def split(self, projected: Tensor, parts: int) -> tuple[Tensor, ...]:
        """(..., parts * C) to `parts` tensors (..., H, D)."""
        return projected.unflatten(-1, (parts, self.heads, -1)).unbind(-3)

    def normalised(self, q: Tensor, k: Tensor) -> tuple[Tensor, Tensor]:
        """Queries and keys as attention takes them."""
        return (self.q_rms_norm(q), self.k_rms_norm(k)) if self.qk_rms_norm else (q, k)


class SelfAttention(_HeadNorms):
    """Attention of the tokens to one another, in the groups that their layout defines.

    Args:
        channels: C of the tokens.
        heads: H; C must be a multiple of it.
        qk_rms_norm: normalise queries and keys per head.

    Raises:
        ValueError: the channels do not divide into the heads.
    """

    def __init__(self, channels: int, heads: int, qk_rms_norm: bool = False) -> None:
        super().__init__(channels, heads, qk_rms_norm)
        self.to_qkv = nn.Linear(channels, 3 * channels)
        self.to_out = nn.Linear(channels, channels)

    def forward(self, h: Tensor, layout: TokenLayout) -> Tensor:
        """Tokens (..., C) to tokens (..., C)."""
        q, k, v = self.split(self.to_qkv(h), 3)
        q, k = self.normalised(q, k)
        return self.to_out(layout.attend(q, k, v).flatten(-2))


class CrossAttention(_HeadNorms):
    """Attention of the tokens to the context of their sample, such as image tokens.

    Args:
        channels, heads, qk_rms_norm: see `SelfAttention`.
        context_channels: channels of the context.

    Raises:
        ValueError: the channels do not divide into the heads.
    """

    def __init__(
        self, channels: int, context_channels: int, heads: int, qk_rms_norm: bool = False
    ) -> None:
        super().__init__(channels, heads, qk_rms_norm)
        self.to_q = nn.Linear(channels, channels)
        self.to_kv = nn.Linear(context_channels, 2 * channels)
        self.to_out = nn.Linear(channels, channels)

    def forward(self, h: Tensor, context: Tensor, layout: TokenLayout) -> Tensor:
        """Tokens (..., C) and context (B, L, context_channels) to tokens (..., C)."""
        (q,) = self.split(self.to_q(h), 1)
        k, v = self.split(self.to_kv(context), 2)
        q, k = self.normalised(q, k)
        return self.to_out(layout.attend_to(q, k, v).flatten(-2))


MAX_PERIOD = 10000.0
_FREQUENCIES = 256  # channels of a time's sines and cosines


def start_at_zero(layer: nn.Module) -> None:
    """Zero the parameters of an output, modulation or last convolution layer."""
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)


def modulation_layer(channels: int) -> nn.Sequential:
    """Time embedding (B, C) to the six modulation vectors (B, 6 C) of adaptive layer norm."""
    return nn.Sequential(nn.SiLU(), nn.Linear(channels, 6 * channels))


def feed_forward(channels: int, ratio: float) -> nn.Sequential:
    """Linear, GELU in its tanh approximation, Linear; `ratio` is hidden channels over channels."""
    hidden = int(channels * ratio)
    layers = nn.Sequential(
        nn.Linear(channels, hidden), nn.GELU(approximate="tanh"), nn.Linear(hidden, channels)
    )
    # Published checkpoints name these `mlp.mlp.0` and `mlp.mlp.2` under a block's `mlp`.
    return nn.Sequential(OrderedDict(mlp=layers))


class ModulatedCrossBlock(nn.Module):
    """Block of both flow transformers: self-attention, cross-attention to the image, MLP.

    Self-attention and MLP are shifted, scaled and gated by the time (adaptive layer norm, Peebles
    and Xie 2023); cross-attention has an affine norm and no gate.

    Args:
        channels, context_channels: C of the tokens, and channels of the context.
        heads: attention heads; C must be a multiple of it.
        mlp_ratio: hidden channels of the MLP over C.
        qk_rms_norm, qk_rms_norm_cross: normalise queries and keys of the self-attention, and of the
            cross-attention.
        share_mod: the model computes the modulation once for all blocks; this block then has no
            modulation layer of its own.
    """

    def __init__(
        self,
        channels: int,
        context_channels: int,
        heads: int,
        mlp_ratio: float = 4.0,
        *,
        qk_rms_norm: bool = False,
        qk_rms_norm_cross: bool = False,
        share_mod: bool = False,
    ) -> None:
        super().__init__()
        self.norm1 = LayerNorm32(channels, affine=False)
        self.norm2 = LayerNorm32(channels, affine=True)
        self.norm3 = LayerNorm32(channels, affine=False)
        self.self_attn = SelfAttention(channels, heads, qk_rms_norm)
        self.cross_attn = CrossAttention(channels, context_channels, heads, qk_rms_norm_cross)
        self.mlp = feed_forward(channels, mlp_ratio)
        self.adaLN_modulation = None if share_mod else modulation_layer(channels)

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Start the modulation at zero, so that only the cross-attention acts; draws nothing."""
        if self.adaLN_modulation is not None:
            start_at_zero(self.adaLN_modulation)

    def forward(self, h: Tensor, modulation: Tensor, cond: Tensor, layout: TokenLayout) -> Tensor:
        """Tokens (..., C) to tokens (..., C).

        Args:
            modulation: (B, C) time embedding, or with `share_mod` the modulation (B, 6 C).
            cond: (B, L, context_channels) context of each sample.
            layout: which tokens belong together.
        """
        if self.adaLN_modulation is not None:
            modulation = self.adaLN_modulation(modulation)
        parts = (layout.spread(part) for part in modulation.chunk(6, dim=1))
        shift_attn, scale_attn, gate_attn, shift_mlp, scale_mlp, gate_mlp = parts
        modulated = self.norm1(h) * (1 + scale_attn) + shift_attn
        h = h + gate_attn * self.self_attn(modulated, layout)
        h = h + self.cross_attn(self.norm2(h), cond, layout)
        modulated = self.norm3(h) * (1 + scale_mlp) + shift_mlp
        return h + gate_mlp * self.mlp(modulated)


class TransformerBlock(nn.Module):
    """Pre-norm block of the structured-latent VAE; its norms have no parameters.

    Arguments are those of `ModulatedCrossBlock`.
    """

    def __init__(
        self, channels: int, heads: int, mlp_ratio: float = 4.0, qk_rms_norm: bool = False
    ) -> None:
        super().__init__()
        self.norm1 = LayerNorm32(channels, affine=False)
        self.norm2 = LayerNorm32(channels, affine=False)
        self.attn = SelfAttention(channels, heads, qk_rms_norm)
        self.mlp = feed_forward(channels, mlp_ratio)

    def forward(self, h: Tensor, layout: TokenLayout) -> Tensor:
        """Tokens (..., C) to tokens (..., C)."""
        h = h + self.attn(self.norm1(h), layout)
        return h + self.mlp(self.norm2(h))


def timestep_embedding(t: Tensor, channels: int) -> Tensor:
    """Cosines, then sines, of times (B,) at geometrically spaced frequencies: (B, channels).

    In float32. Times are multiplied by 1000 already, fractions are fine; `channels` is even
    (Peebles and Xie 2023, DiT).
    """
    half = channels // 2
    # In float32 an angle of 1000 is only good to 6e-5, and its cosine differs between processors.
    steps = torch.arange(half, dtype=torch.float64, device=t.device)
    angles = t.double().unsqueeze(1) * torch.exp(-math.log(MAX_PERIOD) * steps / half)
    return torch.cat([angles.cos(), angles.sin()], dim=1).float()


def absolute_positions(coords: Tensor, channels: int) -> Tensor:
    """Sinusoidal embedding (T, channels) float32 of voxel indices (T, 3), x, y, z, not scaled.

    With f = channels // 3 // 2 frequencies 10000^(-i/f), each axis gives [sin(p w), cos(p w)]; the
    axes follow one another and zeros fill up to `channels`.
    """
    count = channels // 3 // 2
    steps = torch.arange(count, dtype=torch.float64, device=coords.device) / count
    angles = coords.double().unsqueeze(-1) * MAX_PERIOD**-steps
    embedding = torch.cat([angles.sin(), angles.cos()], dim=-1).flatten(1).float()
    return functional.pad(embedding, (0, channels - embedding.shape[1]))


class TimestepEmbedder(nn.Module):
    """Diffusion times to a conditioning vector: sinusoids, Linear, SiLU, Linear, all in float32."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.mlp = nn.Sequential(
            nn.Linear(_FREQUENCIES, channels), nn.SiLU(), nn.Linear(channels, channels)
        )

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw both weights from N(0, 0.02), without touching the biases."""
        for layer in self.mlp:
            if isinstance(layer, nn.Linear):
                nn.init.normal_(layer.weight, std=0.02, generator=generator)

    def forward(self, t: Tensor) -> Tensor:
        """Times (B,), already multiplied by 1000, to (B, channels)."""
        return self.mlp(timestep_embedding(t, _FREQUENCIES))


class SparseResBlock3d(nn.Module):
    """Two 3x3x3 submanifold convolutions around a scale and shift by the time.

        h = conv1(silu(norm1(x)));  h = norm2(h) * (1 + scale) + shift
        out = conv2(silu(h)) + skip(x)

    The linear layer of the time embedding gives scale first, then shift: the reverse of the
    transformer blocks' order.

    The skip connection is linear where input and output channels differ; `emb_channels` are those
    of the time embedding.
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


Size = Annotated[int, Field(ge=1, le=65536)]
"""Channels, heads, cells along an axis: the bound keeps products of a few within 64 bits."""
DEEPEST = 256
"""Blocks in a row, ten times those of the largest published network: each is made in Python."""
Depth = Annotated[int, Field(ge=1, le=DEEPEST)]
Ratio = Annotated[float, Field(gt=0, le=64)]
"""Hidden channels of an MLP over its channels."""


class ModelConfig(Record):
    """Constructor arguments of a network, under the names of the published configurations.

    Args:
        use_fp16: build with a half-precision torso; `set_torso_dtype` overrides it.
    """

    model_config = ConfigDict(protected_namespaces=())

    use_fp16: bool = False


class TransformerConfig(ModelConfig):
    """Arguments that all four transformers of a checkpoint take.

    Args:
        model_channels: C of the tokens inside.
        num_blocks: transformer blocks.
        num_heads: attention heads; None gives `num_head_channels` channels to each.
        num_head_channels: channels of a head, where `num_heads` is None.
        mlp_ratio: hidden channels of the MLPs over C.
        pe_mode: position embedding; only the absolute one was ever published.
        qk_rms_norm: normalise queries and keys of the self-attention.
        use_checkpoint: recompute activations of the blocks in the backward pass.
    """

    model_channels: Size
    num_blocks: int = Field(ge=0, le=DEEPEST)
    num_heads: Size | None = None
    num_head_channels: Size = 64
    mlp_ratio: Ratio = 4.0
    pe_mode: Literal["ape"] = "ape"
    qk_rms_norm: bool = False
    use_checkpoint: bool = False

    @property
    def heads(self) -> int:
        """Attention heads."""
        return self.num_heads or self.model_channels // self.num_head_channels

    @model_validator(mode="after")
    def _heads_divide_channels(self) -> Self:
        if self.heads == 0 or self.model_channels % self.heads:
            raise ValueError(
                f"model_channels {self.model_channels} do not divide into {self.heads} heads"
            )
        return self


class TrellisModel(nn.Module):
    """A network whose `state_dict` has the names, shapes and dtypes of the published checkpoints.

    A subclass builds its modules and ends its constructor with `self.finish()`. All its buffers
    are saved, so a model made under `torch.device("meta")` and then `to_empty(device=...)` is
    complete once `load_published` has filled it.

    Attributes:
        published_name: class name in the published configurations.
        config: constructor arguments, a `config_class`.
        torso: names of the children whose layers change precision.
        checkpointing: recompute the blocks' activations in the backward pass to save memory.
    """

    published_name: ClassVar[str]
    config_class: ClassVar[type[ModelConfig]]
    torso: ClassVar[tuple[str, ...]] = ()

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.checkpointing: bool = getattr(config, "use_checkpoint", False)
        self.torso_dtype = torch.float32

    def finish(self) -> None:
        """Set initial weights and the precision that the configuration asks for.

        On the meta device there are no weights to set.
        """
        if self.device.type != "meta":
            self.initialise()
        self.set_torso_dtype(torch.float16 if self.config.use_fp16 else torch.float32)

    @torch.no_grad()
    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw initial weights: Linear Xavier-uniform with zero bias, dense Conv as in PyTorch.

        Time embeddings are N(0, 0.02) and the modulation of cross blocks starts at zero.
        Subclasses extend this with their own layers that start at zero, such as the output.
        Without a generator, PyTorch's own is taken.
        """
        for module in self.modules():
            if isinstance(module, nn.Linear):
                nn.init.xavier_uniform_(module.weight, generator=generator)
                nn.init.zeros_(module.bias)
            elif isinstance(module, nn.Conv2d | nn.Conv3d):
                nn.init.kaiming_uniform_(module.weight, a=math.sqrt(5), generator=generator)
                if module.bias is not None:
                    bound = 1 / math.sqrt(module.weight[0].numel())
                    nn.init.uniform_(module.bias, -bound, bound, generator=generator)
        for module in self.modules():
            if isinstance(module, TimestepEmbedder | ModulatedCrossBlock):
                module.initialise(generator)

    @property
    def device(self) -> torch.device:
        """Where the parameters live."""
        return next(self.parameters()).device

    def set_torso_dtype(self, dtype: torch.dtype) -> None:
        """Convert the Linear and convolution weights of the torso; norms stay float32.

        Input and output layers, the time embedding and buffers stay float32 too.
        """
        for name in self.torso:
            for module in self.get_submodule(name).modules():
                if not isinstance(module, nn.LayerNorm | MultiHeadRmsNorm):
                    for parameter in module.parameters(recurse=False):
                        parameter.data = parameter.data.to(dtype)
        self.torso_dtype = dtype

    def run_block(self, block: nn.Module, *inputs: Any) -> Any:
        """Call a block of the torso, recomputing it in the backward pass where that is asked."""
        if self.checkpointing and self.training and torch.is_grad_enabled():
            return checkpoint(block, *inputs, use_reentrant=False)
        return block(*inputs)

    def published_state(self) -> dict[str, Tensor]:
        """Parameters and buffers by their published names, not copied."""
        return dict(self.state_dict())

    def load_published(self, state: dict[str, Tensor]) -> None:
        """Copy weights in, converting each to the dtype that this model holds. Raises RuntimeError:
        a name is missing or unknown, or a shape differs."""
        self.load_state_dict(state, strict=True)


@dataclass(frozen=True)
class Posterior:
    """Independent normal distributions, one for each latent value."""

    mean: Tensor  # mean, (B, C, R, R, R) for the sparse structure; what latent caches hold
    logvar: Tensor  # same shape, natural logarithm of the variance

    def sample(self, generator: torch.Generator) -> Tensor:
        """Draw latents; gradients flow into mean and logvar.

        The noise is drawn on the generator's device, so a CPU generator gives the same draw on
        every device.
        """
        noise = torch.randn(
            self.mean.shape,
            generator=generator,
            device=generator.device,
            dtype=self.mean.dtype,
        )
        return self.mean + torch.exp(0.5 * self.logvar) * noise.to(self.mean.device)
