"""Diagonal normal distribution over latents, what the encoders return."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Posterior:
    """Independent normal distributions, one for each latent value.

    Args:
        mean: (B, C, R, R, R) for the sparse structure.
        logvar: same shape, natural logarithm of the variance.
    """

    mean: Tensor
    logvar: Tensor

    @property
    def mode(self) -> Tensor:
        """The most probable latents: the mean, which is what latent caches hold."""
        return self.mean

    def sample(self, generator: torch.Generator) -> Tensor:
        """Draw latents; gradients flow into mean and logvar.

        The noise is drawn on the generator's device, so a CPU generator gives the same draw on
        every device.
        """
        noise = torch.randn(
            self.mean.shape,
            generator=generator,
            device=generator.device,
            dtype=self.mean.dtype,
        )
        return self.mean + torch.exp(0.5 * self.logvar) * noise.to(self.mean.device)
