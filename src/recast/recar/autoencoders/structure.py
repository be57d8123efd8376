"""The sparse-structure autoencoder: occupancy to a small dense latent and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits

from recast.recar.assets.store import AssetStore, occupancy
from recast.recar.training.task import StepLoss, StepRandom
from recast.trellis.models.ss_decoder import SparseStructureDecoder
from recast.trellis.models.ss_encoder import SparseStructureEncoder


@dataclass(frozen=True)
class StructureAutoencoderTask:
    """Dice and cross-entropy of the occupancy, and a little divergence from the normal.

    The published loss is dice alone with 1e-3 of the divergence; cross-entropy makes the first
    minutes quicker. A mirror image across the vehicle's middle plane is as good an example.

    Attributes:
        encoder, decoder: trained.
        store: assets.
        indices: of those to train on.
        resolution: voxels a side.
        batch: assets a step.
        divergence: weight of the divergence, mean over latent values.
    """

    encoder: SparseStructureEncoder
    decoder: SparseStructureDecoder
    store: AssetStore
    indices: Sequence[int]
    resolution: int
    batch: int = 8
    divergence: float = 1e-3

    @property
    def modules(self) -> Mapping[str, nn.Module]:
        """See `TrainingTask.modules`."""
        return {"sparse_structure_encoder": self.encoder, "sparse_structure_decoder": self.decoder}

    def loss(self, step: int, random: StepRandom) -> StepLoss:
        """See `TrainingTask.loss`."""
        chosen = random.numpy.choice(len(self.indices), self.batch)
        grid = occupancy([self.store[self.indices[i]] for i in chosen], self.resolution)
        mirrored = torch.from_numpy(random.numpy.random(self.batch) < 0.5)
        grid = torch.where(mirrored[:, None, None, None, None], grid.flip(3), grid)
        posterior = self.encoder(grid)
        logits = self.decoder(posterior.sample(random.torch))
        dice = dice_loss(logits, grid)
        entropy = binary_cross_entropy_with_logits(logits, grid)
        divergence = normal_divergence(posterior.mean, posterior.logvar)
        loss = dice + entropy + self.divergence * divergence
        overlap = voxel_overlap(logits.detach() > 0, grid > 0)
        return StepLoss(loss, {"dice": float(dice.detach()), "iou": float(overlap.mean())})


def dice_loss(logits: Tensor, grid: Tensor) -> Tensor:
    """1 - (2 sum p s + 1) / (sum p + sum s + 1), mean over samples (B, 1, R, R, R)."""
    p, s = torch.sigmoid(logits).flatten(1), grid.flatten(1)
    return (1 - (2 * (p * s).sum(1) + 1) / (p.sum(1) + s.sum(1) + 1)).mean()


def normal_divergence(mean: Tensor, logvar: Tensor) -> Tensor:
    """Kullback-Leibler divergence from the standard normal, mean over all values."""
    return 0.5 * (mean.square() + logvar.exp() - 1 - logvar).mean()


def voxel_overlap(first: Tensor, second: Tensor) -> Tensor:
    """Intersection over union (B,) of boolean grids (B, ...)."""
    both = (first & second).flatten(1).sum(1)
    either = (first | second).flatten(1).sum(1)
    return both / either.clamp(min=1)
