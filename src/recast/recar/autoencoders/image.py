"""Teaching the compact image encoder to see: regression before any flow is trained.

A flow trained jointly with a fresh encoder learns plausible cars and ignores the picture. Here the
encoder must name structure, direction, proportions and colours; the structure flow's network, fed
no noise, is the head that reads its tokens, and starts the flow.
Colours matter though no shape depends on them: the latent flow reads the same tokens later.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d

from recast.recar.assets.asset import TrainingAsset
from recast.recar.training.task import StepLoss, StepRandom
from recast.trellis.conditioning import CompactImageEncoder
from recast.trellis.models.ss_flow import SparseStructureFlowModel


class ViewHeads(nn.Module):
    """Linear readings of the encoder's tokens.

    The summary token gives azimuth (cosine and sine), extents (3,) and the mean colours of six
    sides (18,); the others each the mean colour (3,) of the pixels they stand for.

    Args:
        channels: of a token.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.azimuth = nn.Linear(channels, 2)
        self.extents = nn.Linear(channels, 3)
        self.sides = nn.Linear(channels, 18)
        self.patches = nn.Linear(channels, 3)

    def forward(self, tokens: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """(B, 2), (B, 3), (B, 18) and (B, L - 1, 3) of tokens (B, L, C)."""
        summary = tokens[:, 0]
        return (
            self.azimuth(summary), self.extents(summary), self.sides(summary),
            self.patches(tokens[:, 1:]),
        )  # fmt: skip


@dataclass(frozen=True)
class ImageExamples:
    """Pictures and what the encoder is to say of them.

    Attributes:
        crops: (N, V, S, S, 3) uint8, V pictures of N assets as `crop_to_object` gives them.
        structures: (N, C, r, r, r) float32 structure latents.
        azimuths: (N, V) float32 radians of the cameras in the asset frame.
        extents: (N, 3) float32 of the assets, longest 1.
        sides: (N, 18) float32 mean colours of their six sides, see `side_colours`.
    """

    crops: np.ndarray
    structures: Tensor
    azimuths: Tensor
    extents: Tensor
    sides: Tensor


@dataclass(frozen=True)
class ImageEncoderTask:
    """Squared error of the structure latent, azimuth, extents and colours.

    Attributes:
        encoder, reader, heads: trained; the reader is called with no noise at time 0.
        examples: see `ImageExamples`.
        indices: assets to train on.
        batch: pictures a step, each of another asset.
        deviation: of the structure latents; their error is measured in it.
    """

    encoder: CompactImageEncoder
    reader: SparseStructureFlowModel
    heads: ViewHeads
    examples: ImageExamples
    indices: Sequence[int]
    batch: int
    deviation: float

    @property
    def modules(self) -> Mapping[str, nn.Module]:
        """See `TrainingTask.modules`."""
        return {
            "image_encoder": self.encoder,
            "sparse_structure_flow_model": self.reader,
            "heads": self.heads,
        }

    def loss(self, step: int, random: StepRandom) -> StepLoss:
        """See `TrainingTask.loss`."""
        chosen = random.numpy.choice(len(self.indices), self.batch, replace=False)
        rows = [self.indices[i] for i in chosen]
        views = random.numpy.integers(self.examples.crops.shape[1], size=self.batch)
        pixels = torch.from_numpy(self.examples.crops[rows, views]).permute(0, 3, 1, 2) / 255
        tokens = self.encoder.encode(pixels)
        structure = read_structure(self.reader, tokens)
        azimuth, extents, sides, patches = self.heads(tokens)
        angle = self.examples.azimuths[rows, views]
        wanted = torch.stack([angle.cos(), angle.sin()], dim=1)
        error = (structure - self.examples.structures[rows]).square().mean()
        error = error / self.deviation**2
        turn = (azimuth - wanted).square().mean()
        shape = (extents - self.examples.extents[rows]).square().mean()
        hue = (sides - self.examples.sides[rows]).square().mean()
        seen = avg_pool2d(pixels, self.encoder.config.patch_size).flatten(2).transpose(1, 2)
        detail = (patches - seen).square().mean()
        logs = {
            "structure": error, "azimuth": turn, "extents": shape, "sides": hue, "patches": detail
        }  # fmt: skip
        return StepLoss(
            error + 0.5 * turn + 5.0 * shape + hue + 5.0 * detail,
            {name: float(value.detach()) for name, value in logs.items()},
        )


def read_structure(reader: SparseStructureFlowModel, tokens: Tensor) -> Tensor:
    """Structure latents (B, C, r, r, r) that a network reads from image tokens (B, L, C)."""
    config = reader.config
    nothing = tokens.new_zeros(len(tokens), config.in_channels, *[config.resolution] * 3)
    out: Tensor = reader(nothing, tokens.new_zeros(len(tokens)), tokens)
    return out


def view_azimuths(asset: TrainingAsset) -> Tensor:
    """(V,) radians at which the cameras of an asset's crops stand: 0 ahead, pi / 2 to its left."""
    poses = asset.poses[: asset.crops].astype(np.float64)
    eyes = -np.einsum("vji,vj->vi", poses[:, :3, :3], poses[:, :3, 3])
    return torch.from_numpy(np.arctan2(eyes[:, 1], eyes[:, 0])).float()


def side_colours(asset: TrainingAsset) -> Tensor:
    """(18,) mean colours in [-1, 1] of what faces +x, -x, +y, -y, +z and -z of an asset.

    A voxel counts for a side with the squared cosine between its normal and the side's; a side
    that nothing faces has the mean colour of all voxels.
    """
    features = torch.from_numpy(asset.features).float()
    colours, normals = features[:, :3], features[:, 3:6]
    facing = torch.cat([normals.clamp(min=0), (-normals).clamp(min=0)], dim=1).square()
    facing = facing[:, [0, 3, 1, 4, 2, 5]] + 1e-6
    return (facing.T @ colours / facing.sum(dim=0)[:, None]).flatten()
