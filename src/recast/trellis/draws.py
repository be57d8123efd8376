"""Random streams of the vehicles of a batch, and the structures drawn from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from recast.errors import InputError
from recast.trellis.generation import GenerationLimits


@dataclass(frozen=True)
class Draw:
    """One vehicle's random stream, on the CPU so that every device makes the same vehicle.

    Attributes:
        seed: of the stream.
        generator: continues after the structure's noise with the latent's.
    """

    seed: int
    generator: torch.Generator = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "generator", torch.Generator().manual_seed(self.seed))


@dataclass(frozen=True)
class Structure:
    """A structure that passed the limits.

    Attributes:
        draw: the stream it came from.
        latent: (C, R, R, R) as sampled.
        coords: (T, 3) int32 active voxels.
    """

    draw: Draw
    latent: Tensor
    coords: Tensor


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
        seeds, names: of the vehicles.
        shape: of one noise, (C, R, R, R).
        sample: from noises (B, C, R, R, R) and which vehicles they are to latents of that shape.
        decode: from one latent to its active voxels (T, 3).
        limits: for the number of retries.
        max_voxels: more of them are too many.

    Raises:
        InputError: a vehicle failed with every seed allowed.
    """
    done: dict[int, Structure] = {}
    for attempt in range(limits.retries + 1):
        waiting = [i for i in range(len(seeds)) if i not in done]
        if not waiting:
            break
        draws = [Draw(seeds[i] + attempt) for i in waiting]
        noise = torch.stack([torch.randn(*shape, generator=d.generator) for d in draws])
        latents = sample(noise, waiting)
        for i, draw, latent in zip(waiting, draws, latents, strict=True):
            coords = decode(latent)
            if 0 < len(coords) <= max_voxels:
                done[i] = Structure(draw, latent, coords)
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
