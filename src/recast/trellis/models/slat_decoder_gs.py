"""Decoder of the structured latents to 3D Gaussians."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn

from recast.splats import Gaussians
from recast.splats.sh import C0
from recast.trellis.models.base import ModelConfig
from recast.trellis.models.gaussians import (
    RepresentationConfig,
    offset_perturbation,
    raw_to_gaussians,
)
from recast.trellis.models.slat_vae import SLatTransformer, SLatVaeConfig
from recast.trellis.sparse import SparseTensor

_BASE_GAIN = 4.0  # harmonics of degree zero span +-1.8 for colours in [0, 1]


class SLatGaussianDecoderConfig(SLatVaeConfig):
    """Arguments of `SLatGaussianDecoder`.

    Args:
        representation_config: how raw channels become Gaussians.
    """

    representation_config: RepresentationConfig


class SLatGaussianDecoder(SLatTransformer):
    """Structured latents (raw, not normalised) to a fixed number of Gaussians per voxel.

    Args:
        config: constructor arguments.

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
