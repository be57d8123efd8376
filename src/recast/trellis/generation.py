"""What a generation is asked for, and what comes out: limits, draws, vehicles, and a model."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from recast.core.errors import InputError
from recast.splats import Gaussians
from recast.weights import shipped_folder

TRAINED_VOXEL_SHARE = 8
"""The published networks were trained on structures of at most 8 R^2 = 32,768 voxels at R = 64."""
RECAST_MINI = "recast-mini"
"""Its name, as a generator and of its folder."""
_VIEWER_FROM_NATIVE = torch.tensor(
    [[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]]
)


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
            raise InputError("`max_voxels`", "value", f"is {self.max_voxels}", "give 1 or more")
        if self.retries < 0:
            raise InputError("`retries`", "value", f"is {self.retries}", "give 0 or more")


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
        vehicles: vehicles in the order of the request.
        seconds: wall time by stage: condition, structure, latent, decode.
        peak_bytes: most memory in use: of the accelerator, or resident memory of this process.
    """

    vehicles: tuple[GeneratedVehicle, ...]
    seconds: Mapping[str, float]
    peak_bytes: int


@dataclass(frozen=True)
class Structure:
    """A structure that passed the limits.

    Attributes:
        generator: random stream that it came from, on the CPU so that every device makes the same
            vehicle; it continues with the latent's noise.
        latent: (C, R, R, R) latent as sampled.
        coords: (T, 3) int32 active voxels.
    """

    generator: torch.Generator
    latent: Tensor
    coords: Tensor

    @property
    def seed(self) -> int:
        """Of the stream."""
        return self.generator.initial_seed()


def draw_structures(
    seeds: Sequence[int],
    names: Sequence[str],
    shape: Sequence[int],
    sample: Callable[[Tensor, list[int]], Tensor],
    decode: Callable[[Tensor], Tensor],
    limits: GenerationLimits,
    max_voxels: int,
) -> list[Structure]:
    """Sample a structure for each seed; one that is empty or too large is drawn anew or refused.

    Args:
        shape: shape of one noise, (C, R, R, R).
        sample: function from noises (B, C, R, R, R) and the indices of their vehicles to latents of
            that shape.
        decode: function from one latent to its active voxels (T, 3).
        limits: limits, of which the number of retries is used.
        max_voxels: largest number of active voxels allowed.

    Raises:
        InputError: a vehicle failed with every seed allowed.
    """
    done: dict[int, Structure] = {}
    for attempt in range(limits.retries + 1):
        waiting = [i for i in range(len(seeds)) if i not in done]
        if not waiting:
            break
        streams = [torch.Generator().manual_seed(seeds[i] + attempt) for i in waiting]
        noise = torch.stack([torch.randn(*shape, generator=stream) for stream in streams])
        latents = sample(noise, waiting)
        for i, stream, latent in zip(waiting, streams, latents, strict=True):
            coords = decode(latent)
            if 0 < len(coords) <= max_voxels:
                done[i] = Structure(stream, latent, coords)
            elif attempt == limits.retries:
                raise _failure(names[i], seeds[i], limits.retries, len(coords), max_voxels)
    return [done[i] for i in range(len(seeds))]


def _failure(name: str, seed: int, retries: int, voxels: int, max_voxels: int) -> InputError:
    tried = f"seed {seed}" if retries == 0 else f"seeds {seed} to {seed + retries}"
    if voxels == 0:
        problem = "the sampled structure is empty"
    else:
        problem = f"the sampled structure has {voxels} voxels, at most {max_voxels} are allowed"
    return InputError(name, tried, problem, "try another seed, more retries or more sampling steps")


class Stopwatch:
    """Measures the stages of one call; work on CUDA is waited for at the end of each stage."""

    def __init__(self, device: torch.device) -> None:
        self.device = device
        self.seconds: dict[str, float] = {}
        if device.type == "cuda":
            torch.cuda.reset_peak_memory_stats(device)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the block to stage `name`."""
        start = time.perf_counter()
        yield
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def peak_bytes(self) -> int:
        """CUDA: most allocated since the start; else the peak resident memory of the process."""
        if self.device.type == "cuda":
            return int(torch.cuda.max_memory_allocated(self.device))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return int(peak if sys.platform == "darwin" else peak * 1024)  # Linux counts kilobytes


def recast_mini() -> Path:
    """Its folder in the published layout, with a model card (README.md)."""
    return shipped_folder(RECAST_MINI)


def viewer_frame(gaussians: Gaussians) -> Gaussians:
    """Turn native Gaussians (z up) into the frame of the usual splat viewers (-y up).

    (x, y, z) becomes (x, -z, y), the default of the published exporter. recast itself works in the
    native frame; its inverse is (x, y, z) = (x', z', -y').
    """
    return gaussians.transformed(_VIEWER_FROM_NATIVE)
