"""What the networks of a TRELLIS checkpoint share: configuration, precision, memory, posterior."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, Self

import torch
from pydantic import ConfigDict, Field, model_validator
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from recast.core.records import Record
from recast.trellis.attention import MultiHeadRmsNorm
from recast.trellis.blocks import ModulatedCrossBlock, TimestepEmbedder

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
        """Copy weights in, converting each to the dtype that this model holds.

        Raises:
            RuntimeError: a name is missing or unknown, or a shape differs.
        """
        self.load_state_dict(state, strict=True)


@dataclass(frozen=True)
class Posterior:
    """Independent normal distributions, one for each latent value.

    Attributes:
        mean: mean, (B, C, R, R, R) for the sparse structure; what latent caches hold.
        logvar: same shape, natural logarithm of the variance.
    """

    mean: Tensor
    logvar: Tensor

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
