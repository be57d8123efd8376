"""Encoder of the structured latents: image features on voxels to a distribution of latents."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import nn

from recast.trellis.models.base import ModelConfig, Size
from recast.trellis.models.posterior import Posterior
from recast.trellis.models.slat_vae import SLatTransformer, SLatVaeConfig
from recast.trellis.sparse import SparseTensor


@dataclass(frozen=True)
class SparsePosterior:
    """Independent normal distributions of the latents of every voxel.

    Attributes:
        mean: (T, C) voxels.
        logvar: (T, C) natural log of the variance, on the same voxels.
    """

    mean: SparseTensor
    logvar: SparseTensor

    @property
    def mode(self) -> SparseTensor:
        """The most likely latents, the ones to cache as training targets."""
        return self.mean

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

    Args:
        config: constructor arguments.
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
