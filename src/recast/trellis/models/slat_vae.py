"""Encoder and decoder of the structured latents: image features on voxels, latents, 3D Gaussians.

Both are a sparse windowed transformer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import torch
from torch import Tensor, nn

from recast.splats import Gaussians
from recast.splats.sh import C0
from recast.trellis.attention import final_norm
from recast.trellis.blocks import TransformerBlock, absolute_positions, start_at_zero
from recast.trellis.models.base import ModelConfig, Posterior, Size, TransformerConfig, TrellisModel
from recast.trellis.models.gaussians import (
    RepresentationConfig,
    offset_perturbation,
    raw_to_gaussians,
)
from recast.trellis.sparse import SparseTensor, WindowedTokens

_BASE_GAIN = 4.0  # harmonics of degree zero span +-1.8 for colours in [0, 1]


class SLatVaeConfig(TransformerConfig):
    """Arguments that `SLatEncoder` and `SLatGaussianDecoder` share.

    Args:
        resolution: R, voxels along an edge of the unit cube.
        latent_channels: channels of the latent of a voxel.
        attn_mode: attention in windows, the only mode of the published models.
        window_size: edge of a window in voxels; every other block is shifted by half of it.
    """

    resolution: Size
    latent_channels: Size
    attn_mode: Literal["swin"] = "swin"
    window_size: Size = 8


class SLatTransformer(TrellisModel):
    """Transformer over voxels with attention in windows, half a window apart in every other block.

    `in_channels` and `out_channels` are the features and outputs of a voxel.
    """

    torso: ClassVar[tuple[str, ...]] = ("blocks",)
    config: SLatVaeConfig

    def __init__(self, config: SLatVaeConfig, in_channels: int, out_channels: int) -> None:
        super().__init__(config)
        c = config.model_channels
        self.input_layer = nn.Linear(in_channels, c)
        self.blocks = nn.ModuleList(
            TransformerBlock(c, config.heads, config.mlp_ratio, config.qk_rms_norm)
            for _ in range(config.num_blocks)
        )
        self.out_layer = nn.Linear(c, out_channels)

    @torch.no_grad()
    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw initial weights; the output starts at zero."""
        super().initialise(generator)
        start_at_zero(self.out_layer)

    def outputs(self, x: SparseTensor) -> Tensor:
        """Features (T, in_channels) of the voxels to (T, out_channels), in the dtype of `x`."""
        h = self.input_layer(x.feats)
        h = h + absolute_positions(x.coords[:, 1:], h.shape[1])
        h = h.to(self.torso_dtype)
        window = self.config.window_size
        layouts = [WindowedTokens(x, window, shift) for shift in (0, window // 2)]
        for i, block in enumerate(self.blocks):
            h = self.run_block(block, h, layouts[i % 2])
        return self.out_layer(final_norm(h.to(x.feats.dtype)))


@dataclass(frozen=True)
class SparsePosterior:
    """Independent normal distributions of the latents of every voxel.

    `mean` (T, C), and `logvar` (T, C) on the same voxels; see `Posterior`.
    """

    mean: SparseTensor
    logvar: SparseTensor

    def sample(self, generator: torch.Generator) -> SparseTensor:
        """Draw latents; gradients flow into mean and logvar, see `Posterior.sample`."""
        posterior = Posterior(self.mean.feats, self.logvar.feats)
        return self.mean.with_feats(posterior.sample(generator))


class SLatEncoderConfig(SLatVaeConfig):
    """Arguments of `SLatEncoder`.

    Args:
        in_channels: image features of a voxel.
        skip_latent: add a linear map of the features to the latent's mean, so that what lies on a
            voxel, its colour above all, need not pass the normalisations. In no published model.
    """

    in_channels: Size
    skip_latent: bool = False


class SLatEncoder(SLatTransformer):
    """Image features gathered on the voxels of an asset, to its structured latents.

    The published encoder takes DINOv2 patch features averaged over 150 views of the asset
    (Xiang et al., Structured 3D Latents for Scalable and Versatile 3D Generation, CVPR 2025).
    """

    published_name: ClassVar[str] = "SLatEncoder"
    config_class: ClassVar[type[ModelConfig]] = SLatEncoderConfig
    config: SLatEncoderConfig

    def __init__(self, config: SLatEncoderConfig) -> None:
        super().__init__(config, config.in_channels, 2 * config.latent_channels)
        self.skip_latent = (
            nn.Linear(config.in_channels, config.latent_channels) if config.skip_latent else None
        )
        self.finish()

    @torch.no_grad()
    def initialise(self, generator: torch.Generator | None = None) -> None:
        """As the base; the skip hands the first features over as they are, one to a channel."""
        super().initialise(generator)
        if self.skip_latent is not None:
            nn.init.eye_(self.skip_latent.weight)

    def forward(self, x: SparseTensor) -> SparsePosterior:
        """(T, in_channels) voxels to the distribution of their (T, latent_channels) latents."""
        mean, logvar = self.outputs(x).chunk(2, dim=1)
        if self.skip_latent is not None:
            mean = mean + self.skip_latent(x.feats)
        return SparsePosterior(x.with_feats(mean), x.with_feats(logvar))


class SLatGaussianDecoderConfig(SLatVaeConfig):
    """Arguments of `SLatGaussianDecoder`.

    Args:
        representation_config: how raw channels become Gaussians.
    """

    representation_config: RepresentationConfig


class SLatGaussianDecoder(SLatTransformer):
    """Structured latents (raw, not normalised) to a fixed number of Gaussians per voxel.

    Attributes:
        offset_perturbation: (G, 3) buffer that spreads the Gaussians of a voxel; stored in the
            checkpoints, float32.
    """

    published_name: ClassVar[str] = "SLatGaussianDecoder"
    config_class: ClassVar[type[ModelConfig]] = SLatGaussianDecoderConfig
    config: SLatGaussianDecoderConfig
    offset_perturbation: Tensor

    def __init__(self, config: SLatGaussianDecoderConfig) -> None:
        representation = config.representation_config
        super().__init__(config, config.latent_channels, representation.channels)
        self.base_color = (
            nn.Linear(config.latent_channels, 3) if representation.base_color else None
        )
        self.register_buffer("offset_perturbation", torch.empty(representation.num_gaussians, 3))
        self.finish()

    @torch.no_grad()
    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw initial weights and compute the perturbation; the raw output starts at zero."""
        super().initialise(generator)
        self.offset_perturbation.copy_(offset_perturbation(self.config.representation_config))
        if self.base_color is not None:
            # The first three channels as colours in [-1, 1]; see `SLatEncoderConfig.skip_latent`.
            nn.init.eye_(self.base_color.weight)
            self.base_color.weight.mul_(0.5 / (_BASE_GAIN * C0))

    def forward(self, x: SparseTensor) -> SparseTensor:
        """(T, latent_channels) latents to (T, 14 G) raw channels on the same voxels."""
        raw = self.outputs(x)
        if self.base_color is not None:
            g = self.config.representation_config.num_gaussians
            position, colour, rest = raw.split([3 * g, 3 * g, 8 * g], dim=1)
            base = _BASE_GAIN * self.base_color(x.feats).to(raw.dtype)
            raw = torch.cat([position, colour + base.repeat(1, g), rest], dim=1)
        return x.with_feats(raw)

    def gaussians(self, raw: SparseTensor) -> list[Gaussians]:
        """The Gaussians of every sample; none for a sample without voxels.

        Args:
            raw: (T, 14 G) output of this decoder; differentiable.

        Returns:
            One set per sample in the unit cube [-0.5, 0.5]^3, z up, see `raw_to_gaussians`.
        """
        return [
            raw_to_gaussians(
                raw.feats[rows],
                raw.coords[rows, 1:],
                self.offset_perturbation,
                self.config.representation_config,
                self.config.resolution,
            )
            for rows in raw.slices
        ]
