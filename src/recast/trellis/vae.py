"""The autoencoders of a vehicle's structure and of its looks.

The first takes an occupancy grid to a small latent grid, and back to occupied voxels. The second
takes structured latents to the raw channels of 3D Gaussians in the unit cube.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, Literal

import numpy as np
import torch
from pydantic import ConfigDict, Field
from torch import Tensor, nn
from torch.nn import functional

from recast.core.records import Record
from recast.splats import Gaussians
from recast.splats.gaussians import C0
from recast.trellis.layers import (
    ChannelLayerNorm32,
    Depth,
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


class SparseStructureVaeConfig(ModelConfig):
    """Arguments that `SparseStructureEncoder` and `SparseStructureDecoder` share.

    Args:
        latent_channels: channels of the latent.
        num_res_blocks: residual blocks of each level.
        channels: channels of each level, in the order of the data; levels differ by two in
            resolution.
        num_res_blocks_middle: residual blocks at the coarsest level beside those.
        norm_type: kind of normalisation; no other value was published.
    """

    latent_channels: Size
    num_res_blocks: Depth
    channels: tuple[Size, ...] = Field(min_length=1, max_length=16)
    num_res_blocks_middle: Depth = 2
    norm_type: Literal["layer"] = "layer"


class ResBlock3d(nn.Module):
    """x + conv(SiLU(norm(conv(SiLU(norm(x)))))), with 3x3x3 convolutions.

    The published networks never change the channels inside a block.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm1 = ChannelLayerNorm32(channels)
        self.norm2 = ChannelLayerNorm32(channels)
        self.conv1 = nn.Conv3d(channels, channels, 3, padding=1)
        self.conv2 = nn.Conv3d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """Grid (B, channels, X, Y, Z) to the same shape."""
        h = self.conv1(functional.silu(self.norm1(x)))
        return x + self.conv2(functional.silu(self.norm2(h)))


def downsample_3d(in_channels: int, out_channels: int) -> nn.Sequential:
    """Grid (B, in_channels, 2X, 2Y, 2Z) to (B, out_channels, X, Y, Z).

    A 2x2x2 convolution of stride 2.
    """
    return nn.Sequential(OrderedDict(conv=nn.Conv3d(in_channels, out_channels, 2, stride=2)))


class Upsample3d(nn.Module):
    """Double a grid: a 3x3x3 convolution to eight times the channels, then a pixel shuffle."""

    def __init__(self, in_channels: int, out_channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv3d(in_channels, 8 * out_channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """Grid (B, in_channels, X, Y, Z) to (B, out_channels, 2X, 2Y, 2Z)."""
        return channels_last(pixel_shuffle_3d(self.conv(x)))


def channels_last(grid: Tensor) -> Tensor:
    """The same grid (B, C, X, Y, Z), channels last in memory.

    The norms want it so, and with few channels the convolutions then take half the time on a CPU.
    """
    return grid.contiguous(memory_format=torch.channels_last_3d)


def pixel_shuffle_3d(x: Tensor, factor: int = 2) -> Tensor:
    """Move channels into space: channel c r^3 + (dx r + dy) r + dz goes to cell offset dx, dy, dz.

    From (B, C r^3, X, Y, Z) to (B, C, r X, r Y, r Z), r = `factor`.
    """
    batch, _, *size = x.shape
    split = x.reshape(batch, -1, factor, factor, factor, *size)
    woven = split.permute(0, 1, 5, 2, 6, 3, 7, 4)
    return woven.reshape(batch, split.shape[1], *(factor * n for n in size))


class SparseStructureVae(TrellisModel):
    """What encoder and decoder share; a subclass adds `blocks` and `middle_block` in its order."""

    torso = ("blocks", "middle_block")
    config: SparseStructureVaeConfig
    input_layer: nn.Conv3d
    out_layer: nn.Sequential

    def res_blocks(self, channels: int, count: int) -> nn.Sequential:
        """Residual blocks in a row."""
        return nn.Sequential(*(ResBlock3d(channels) for _ in range(count)))

    def levels(self, change: Callable[[int, int], nn.Module]) -> nn.ModuleList:
        """The residual blocks of each level, and what takes one to the next between them."""
        channels, count = self.config.channels, self.config.num_res_blocks
        blocks = nn.ModuleList(self.res_blocks(channels[0], count))
        for before, after in pairwise(channels):
            blocks.append(change(before, after))
            blocks.extend(self.res_blocks(after, count))
        return blocks

    def head(self, out_channels: int) -> nn.Sequential:
        """The output layer."""
        last = self.config.channels[-1]
        return nn.Sequential(
            ChannelLayerNorm32(last), nn.SiLU(), nn.Conv3d(last, out_channels, 3, padding=1)
        )

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Convolutions as in PyTorch; each residual block starts as the identity."""
        super().initialise(generator)
        for block in self.modules():
            if isinstance(block, ResBlock3d):
                start_at_zero(block.conv2)

    def run(self, x: Tensor, blocks: Iterable[nn.Module]) -> Tensor:
        """Input layer, blocks in the torso's precision, output layer."""
        h = self.input_layer(channels_last(x))
        outer = h.dtype
        h = h.to(self.torso_dtype)
        for block in blocks:
            h = self.run_block(block, h)
        return self.out_layer(h.to(outer))


class SparseStructureEncoderConfig(SparseStructureVaeConfig):
    """Arguments of `SparseStructureEncoder`.

    Args:
        in_channels: channels of the grid; 1 for occupancy.
    """

    in_channels: Size


class SparseStructureEncoder(SparseStructureVae):
    """Convolutional encoder of the sparse-structure autoencoder; official size 64^3 to 16^3."""

    published_name = "SparseStructureEncoder"
    config_class: ClassVar[type[ModelConfig]] = SparseStructureEncoderConfig
    config: SparseStructureEncoderConfig

    def __init__(self, config: SparseStructureEncoderConfig) -> None:
        super().__init__(config)
        levels = config.channels
        self.input_layer = nn.Conv3d(config.in_channels, levels[0], 3, padding=1)
        self.blocks = self.levels(downsample_3d)
        self.middle_block = self.res_blocks(levels[-1], config.num_res_blocks_middle)
        self.out_layer = self.head(2 * config.latent_channels)
        self.finish()

    def forward(self, grid: Tensor) -> Posterior:
        """Distribution of the latent.

        Args:
            grid: (B, in_channels, R, R, R) occupancy 0 or 1, in any dtype.

        Returns:
            Mean and logvar (B, latent_channels, R / f, R / f, R / f) with f = 2^(levels - 1).
        """
        grid = grid.to(self.input_layer.weight.dtype)
        mean, logvar = self.run(grid, (*self.blocks, *self.middle_block)).chunk(2, dim=1)
        return Posterior(mean, logvar)


class SparseStructureDecoderConfig(SparseStructureVaeConfig):
    """Arguments of `SparseStructureDecoder`.

    Args:
        out_channels: channels of the grid; 1 for occupancy.
    """

    out_channels: Size


class SparseStructureDecoder(SparseStructureVae):
    """Convolutional decoder of the sparse-structure autoencoder; official size 16^3 to 64^3."""

    published_name = "SparseStructureDecoder"
    config_class: ClassVar[type[ModelConfig]] = SparseStructureDecoderConfig
    config: SparseStructureDecoderConfig

    def __init__(self, config: SparseStructureDecoderConfig) -> None:
        super().__init__(config)
        levels = config.channels
        self.input_layer = nn.Conv3d(config.latent_channels, levels[0], 3, padding=1)
        self.middle_block = self.res_blocks(levels[0], config.num_res_blocks_middle)
        self.blocks = self.levels(Upsample3d)
        self.out_layer = self.head(config.out_channels)
        self.finish()

    def forward(self, z: Tensor) -> Tensor:
        """Occupancy logits; a voxel is occupied where its logit is positive.

        Args:
            z: (B, latent_channels, r, r, r) latents, not normalised.

        Returns:
            (B, out_channels, R, R, R) with R = r 2^(levels - 1), in the dtype of `z`.
        """
        return self.run(z, (*self.middle_block, *self.blocks))


def occupied_voxels(logits: Tensor) -> Tensor:
    """Voxels of logits (B, 1, R, R, R) above zero: (T, 4) int32 rows [batch, x, y, z].

    The rows are sorted lexicographically.
    """
    return torch.argwhere(logits > 0)[:, [0, 2, 3, 4]].int()


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
