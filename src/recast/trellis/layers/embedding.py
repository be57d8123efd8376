"""Sinusoidal embeddings of diffusion times and voxel positions."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

MAX_PERIOD = 10000.0


def timestep_embedding(t: Tensor, channels: int = 256) -> Tensor:
    """Cosines, then sines, of a time at geometrically spaced frequencies.

    Args:
        t: (B,) times, already multiplied by 1000; fractions are fine.
        channels: length of the embedding, even.

    Returns:
        (B, channels) float32, cosines in the first half (Peebles and Xie 2023, DiT).
    """
    half = channels // 2
    # In float32 an angle of 1000 is only good to 6e-5, and its cosine differs between processors.
    steps = torch.arange(half, dtype=torch.float64, device=t.device)
    angles = t.double().unsqueeze(1) * torch.exp(-math.log(MAX_PERIOD) * steps / half)
    return torch.cat([angles.cos(), angles.sin()], dim=1).float()


def absolute_positions(coords: Tensor, channels: int) -> Tensor:
    """Sinusoidal embedding of integer positions, axis after axis.

    With f = channels // 3 // 2 frequencies 10000^(-i/f), each axis gives [sin(p w), cos(p w)]; the
    axes follow one another and zeros fill up to `channels`.

    Args:
        coords: (T, 3) voxel indices, x, y, z, not scaled.
        channels: length of the embedding.

    Returns:
        (T, channels) float32.
    """
    count = channels // 3 // 2
    steps = torch.arange(count, dtype=torch.float64, device=coords.device) / count
    angles = coords.double().unsqueeze(-1) * MAX_PERIOD**-steps
    waves = torch.cat([angles.sin(), angles.cos()], dim=-1).flatten(1).float()
    return functional.pad(waves, (0, channels - waves.shape[1]))


class TimestepEmbedder(nn.Module):
    """Diffusion times to a conditioning vector: sinusoids, Linear, SiLU, Linear, all in float32.

    Args:
        channels: length of the vector.
        frequency_channels: length of the sinusoidal embedding.
    """

    def __init__(self, channels: int, frequency_channels: int = 256) -> None:
        super().__init__()
        self.frequency_channels = frequency_channels
        self.mlp = nn.Sequential(
            nn.Linear(frequency_channels, channels), nn.SiLU(), nn.Linear(channels, channels)
        )

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw both weights from N(0, 0.02), without touching the biases."""
        for layer in self.mlp:
            if isinstance(layer, nn.Linear):
                nn.init.normal_(layer.weight, std=0.02, generator=generator)

    def forward(self, t: Tensor) -> Tensor:
        """Times (B,), already multiplied by 1000, to (B, channels)."""
        out: Tensor = self.mlp(timestep_embedding(t, self.frequency_channels))
        return out
