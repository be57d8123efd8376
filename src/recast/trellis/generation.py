"""What a generation is asked for, and what comes out of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from torch import Tensor

from recast.errors import InputError
from recast.splats import Gaussians

TRAINED_VOXEL_SHARE = 8
"""The published networks were trained on structures of at most 8 R^2 = 32,768 voxels at R = 64."""


@dataclass(frozen=True)
class GenerationLimits:
    """What counts as a failed structure, and how often another seed is tried.

    Attributes:
        max_voxels: a structure with more active voxels is refused; None takes 8 R^2, the most that
            the published networks saw in training. Few sampling steps make structures explode.
        retries: further seeds (seed + 1, seed + 2, ...) tried for a vehicle whose structure is
            empty or too large.

    Raises:
        InputError: fewer than one voxel, or fewer than no retries.
    """

    max_voxels: int | None = None
    retries: int = 0

    def __post_init__(self) -> None:
        if self.max_voxels is not None and self.max_voxels < 1:
            raise InputError("--max-voxels", "value", f"is {self.max_voxels}", "give 1 or more")
        if self.retries < 0:
            raise InputError("--retries", "value", f"is {self.retries}", "give 0 or more")


@dataclass(frozen=True)
class GeneratedVehicle:
    """One vehicle in the frame of the networks: unit cube [-0.5, 0.5]^3, z up, any heading.

    Attributes:
        gaussians: the decoded asset, degree-zero harmonics.
        seed: the one that made it, which differs from the one asked for after a retry.
        structure: (C, R/8.., R/8.., R/8..) sparse-structure latent as sampled.
        coords: (T, 3) int32 active voxels.
        latent: (T, C) structured latent on them, de-normalised.
    """

    gaussians: Gaussians
    seed: int
    structure: Tensor
    coords: Tensor
    latent: Tensor


@dataclass(frozen=True)
class Generation:
    """The vehicles of one call, and what it cost.

    Attributes:
        vehicles: in the order of the request.
        seconds: wall time by stage: condition, structure, latent, decode.
        peak_bytes: most memory in use: of the accelerator, or resident memory of this process.
    """

    vehicles: tuple[GeneratedVehicle, ...]
    seconds: Mapping[str, float]
    peak_bytes: int
