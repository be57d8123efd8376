"""From the raw channels of the Gaussian decoder to 3D Gaussians in the unit cube."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import torch
from pydantic import ConfigDict, Field
from torch import Tensor

from recast.core.records import Record
from recast.splats import Gaussians


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
