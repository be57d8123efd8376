"""From the raw channels of the Gaussian decoder to 3D Gaussians in the unit cube."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import torch
from pydantic import ConfigDict, Field
from torch import Tensor, nn

from recast.core.records import Record
from recast.splats import Gaussians
from recast.splats.sh import C0
from recast.trellis.layers import (
    ModelConfig,
    Posterior,
    Size,
    TransformerBlock,
    TransformerConfig,
    TrellisModel,
    absolute_positions,
    final_norm,
    start_at_zero,
)
from recast.trellis.sparse import SparseTensor, WindowedTokens


class RateFactors(Record):
    """Factors on the raw channels, named "lr" in the published files: relative learning rates."""

    model_config = ConfigDict(populate_by_name=True)

    position: float = Field(default=1.0, alias="_xyz")
    colour: float = Field(default=1.0, alias="_features_dc")
    opacity: float = Field(default=1.0, alias="_opacity")
    scale: float = Field(default=1.0, alias="_scaling")
    rotation: float = Field(default=0.1, alias="_rotation")


class RepresentationConfig(Record):
    """How a voxel's channels become Gaussians; defaults are the published decoder's.

    Read and written under the published names (`model_dump(by_alias=True)`).

    Attributes:
        rates: factors on the raw channels.
        perturb_offset: spread the Gaussians of a voxel by `offset_perturbation`.
        voxel_size: edge of the cube that a voxel's centres may reach, in voxels; over 1, since the
            first Gaussian of the spread lies at one voxel's corner.
        num_gaussians: Gaussians per voxel, G.
        filter_2d: variance in pixels squared with which the published renderer blurs the image;
            no part of the Gaussians.
        filter_3d: standard deviation, in unit cubes, added to each axis in quadrature.
        scaling_bias: standard deviation in unit cubes for raw 0, before `filter_3d`.
        opacity_bias: opacity for raw 0.
        scaling_activation: maps raw channels to standard deviations.
        base_color: a linear layer from the latent of a voxel adds one colour to all its Gaussians.
            In no published model: small ones learn hue last without it.
    """

    model_config = ConfigDict(populate_by_name=True)

    rates: RateFactors = Field(default_factory=RateFactors, alias="lr")
    perturb_offset: bool = True
    voxel_size: float = Field(default=1.5, gt=1.0)
    num_gaussians: int = Field(default=32, ge=1, le=4096)
    filter_2d: float = Field(default=0.1, ge=0.0, alias="2d_filter_kernel_size")
    filter_3d: float = Field(default=9e-4, gt=0.0, alias="3d_filter_kernel_size")
    scaling_bias: float = Field(default=4e-3, gt=0.0)
    opacity_bias: float = Field(default=0.1, gt=0.0, lt=1.0)
    scaling_activation: Literal["softplus"] = "softplus"
    base_color: bool = False

    @property
    def channels(self) -> int:
        """Raw channels per voxel: 3 position, 3 colour, 3 scale, 4 rotation, 1 opacity each."""
        return 14 * self.num_gaussians


def hammersley(count: int) -> Tensor:
    """Hammersley's evenly spread points of the unit cube, (count, 3) float32.

    Point g is g / count and g's digits in base 2 and 3, mirrored at the radix point, in [0, 1)
    (Hammersley 1960).
    """
    from scipy.stats.qmc import Halton  # imports for most of a second, which only training pays

    points = np.column_stack([np.arange(count) / count, Halton(2, scramble=False).random(count)])
    return torch.from_numpy(points).float()


def offset_perturbation(config: RepresentationConfig) -> Tensor:
    """The stored buffer (G, 3): what puts raw 0 at Hammersley's points of the one-voxel cube."""
    return torch.atanh((hammersley(config.num_gaussians) * 2 - 1) / config.voxel_size)


def split_raw(raw: Tensor, config: RepresentationConfig) -> dict[str, Tensor]:
    """Cut the raw channels (T, 14 G) of T voxels into attributes, each times its rate, in float32.

    All positions come first, then colours, scales, rotations, opacities: position, colour, scale
    (T, G, 3), rotation (T, G, 4), opacity (T, G, 1).
    """
    g = config.num_gaussians
    widths = {"position": 3, "colour": 3, "scale": 3, "rotation": 4, "opacity": 1}
    parts = raw.float().split([g * width for width in widths.values()], dim=1)
    return {
        name: part.unflatten(1, (g, -1)) * getattr(config.rates, name)
        for name, part in zip(widths, parts, strict=True)
    }


def raw_to_gaussians(
    raw: Tensor,
    coords: Tensor,
    perturbation: Tensor,
    config: RepresentationConfig,
    resolution: int,
) -> Gaussians:
    """Gaussians of one sample, differentiable in `raw` (Xiang et al., CVPR 2025; published code).

    Each voxel (i, j, k) of the R^3 grid holds G Gaussians, whatever the raw values within
    voxel_size / 2 of its centre along each axis:

        mean    = (ijk + 0.5) / R - 0.5 + tanh(raw + perturbation) * voxel_size / (2 R)
        sigma   = sqrt(softplus(raw + ln(expm1(scaling_bias)))^2 + filter_3d^2)
        quat    = normalise(raw + [1, 0, 0, 0]);  opacity = sigmoid(raw + logit(opacity_bias))
        colour  = harmonics of degree 0

    with every raw value first multiplied by its rate factor.

    Args:
        raw: (T, 14 G) channels, see `split_raw`.
        coords: (T, 3) integer voxels.
        perturbation: (G, 3) stored buffer, see `offset_perturbation`.
        resolution: R, voxels along an edge of the unit cube.

    Returns:
        T * G float32 Gaussians, voxel by voxel, in the unit cube [-0.5, 0.5]^3, z up.
    """
    part = split_raw(raw, config)
    offset = part["position"]
    if config.perturb_offset:
        offset = offset + perturbation
    centre = (coords.float() + 0.5) / resolution - 0.5
    reach = 0.5 * config.voxel_size / resolution
    sigma = torch.nn.functional.softplus(part["scale"] + math.log(math.expm1(config.scaling_bias)))
    upright = torch.tensor([1.0, 0.0, 0.0, 0.0], device=raw.device)
    odds = math.log(config.opacity_bias / (1.0 - config.opacity_bias))
    return Gaussians(
        means=(centre.unsqueeze(1) + torch.tanh(offset) * reach).flatten(0, 1),
        quats=torch.nn.functional.normalize(part["rotation"] + upright, dim=-1).flatten(0, 1),
        log_scales=torch.hypot(sigma, sigma.new_tensor(config.filter_3d)).log().flatten(0, 1),
        logit_opacities=(part["opacity"] + odds).flatten(),
        sh=part["colour"].reshape(-1, 1, 3),
    )


# Encoder and decoder of the structured latents: image features on voxels, latents, 3D Gaussians.
#
# Both are a sparse windowed transformer.

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
