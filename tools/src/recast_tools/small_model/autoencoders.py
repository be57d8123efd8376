"""What small models are built on: autoencoders of structure and latents, and the image encoder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, binary_cross_entropy_with_logits

from recast.recar.training_conditions import TrainingAsset
from recast.reconstruction.scores import ssim_map
from recast.splats import MIP, Gaussians, Rasterization, rasterize
from recast.training.loop import StepLoss, StepRandom
from recast.trellis.conditioning import CompactImageEncoder
from recast.trellis.flow_transformer import SparseStructureFlowModel
from recast.trellis.vae import (
    SLatEncoder,
    SLatGaussianDecoder,
    SparseStructureDecoder,
    SparseStructureEncoder,
)
from recast_tools.small_model.asset_store import AssetStore, occupancy, voxel_features


@dataclass(frozen=True)
class StructureAutoencoderTask:
    """Dice and cross-entropy of the occupancy, and a little divergence from the normal.

    The published loss is dice alone with 1e-3 of the divergence; cross-entropy makes the first
    minutes quicker. A mirror image across the vehicle's middle plane is as good an example.

    Attributes:
        encoder, decoder: networks that are trained.
        store: store of the assets.
        indices: numbers of the assets to train on.
        resolution: number of voxels a side.
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


@dataclass(frozen=True)
class LatentAutoencoderTask:
    """Renders of the decoded Gaussians against the asset's pictures.

    L1 + 0.5 L1 of alpha + 0.2 (1 - SSIM) + a little divergence, on a random background colour, so
    that holes and halos are seen. The published loss has LPIPS instead of the alpha term.

    Attributes:
        encoder, decoder: networks that are trained.
        store: store of the assets.
        indices: numbers of the assets to train on.
        views: pictures a step, of one asset.
        divergence: weight of the divergence; small, the flow wants information more than a normal.
    """

    encoder: SLatEncoder
    decoder: SLatGaussianDecoder
    store: AssetStore
    indices: Sequence[int]
    views: int = 2
    divergence: float = 1e-6

    @property
    def modules(self) -> Mapping[str, nn.Module]:
        """See `TrainingTask.modules`."""
        return {"slat_encoder": self.encoder, "slat_decoder_gs": self.decoder}

    def loss(self, step: int, random: StepRandom) -> StepLoss:
        """See `TrainingTask.loss`."""
        asset = self.store[self.indices[int(random.numpy.integers(len(self.indices)))]]
        posterior = self.encoder(voxel_features([asset]))
        (gaussians,) = self.decoder.gaussians(self.decoder(posterior.sample(random.torch)))
        background = torch.from_numpy(random.numpy.random(3)).float()
        chosen = random.numpy.choice(len(asset.pictures), self.views, replace=False)
        total = torch.zeros(())
        error = 0.0
        for view in chosen:
            drawn = draw(gaussians, asset, int(view), background)
            truth, alpha = picture(asset, int(view), background)
            total = total + (drawn.rgb - truth).abs().mean()
            total = total + 0.5 * (drawn.alpha - alpha).abs().mean()
            total = total + 0.2 * (1 - ssim_map(drawn.rgb, truth).mean())
            error += float((drawn.rgb.detach() - truth).square().mean()) / self.views
        divergence = normal_divergence(posterior.mean.feats, posterior.logvar.feats)
        loss = total / self.views + self.divergence * divergence
        return StepLoss(loss, {"mse": error, "divergence": float(divergence.detach())})


def draw(
    gaussians: Gaussians, asset: TrainingAsset, view: int, background: Tensor
) -> Rasterization:
    """Render Gaussians in the unit cube as the camera of an asset's picture sees them."""
    side = asset.pictures.shape[1]
    focal = float(asset.focal[view])
    camera = torch.tensor([[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1]])
    return rasterize(
        gaussians,
        torch.from_numpy(asset.poses[view]),
        camera,
        side,
        side,
        background=background,
        eps2d=MIP.variance,
        antialiased=MIP.antialiased,
    )


def picture(asset: TrainingAsset, view: int, background: Tensor) -> tuple[Tensor, Tensor]:
    """(S, S, 3) display colours before a background, and alpha (S, S)."""
    rgba = torch.from_numpy(asset.pictures[view]).float() / 255
    alpha = rgba[..., 3:]
    return rgba[..., :3] * alpha + background * (1 - alpha), alpha[..., 0]


class ViewHeads(nn.Module):
    """Linear readings of the encoder's tokens.

    The summary token gives azimuth (cosine and sine), extents (3,) and the mean colours of six
    sides (18,); the others each the mean colour (3,) of the pixels they stand for.

    Args:
        channels: number of channels of a token.
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
            self.azimuth(summary),
            self.extents(summary),
            self.sides(summary),
            self.patches(tokens[:, 1:]),
        )


@dataclass(frozen=True)
class ImageExamples:
    """Pictures and what the encoder is to say of them.

    Attributes:
        crops: (N, V, S, S, 3) uint8, V pictures of N assets as `crop_to_object` gives them.
        structures: (N, C, r, r, r) float32 structure latents.
        azimuths: (N, V) float32 radians of the cameras in the asset frame.
        extents: (N, 3) float32 extents of the assets, longest 1.
        sides: (N, 18) float32 mean colours of their six sides, see `side_colours`.
    """

    crops: np.ndarray
    structures: Tensor
    azimuths: Tensor
    extents: Tensor
    sides: Tensor


@dataclass(frozen=True)
class ImageEncoderTask:
    """Teaches the compact image encoder to see, by regression, before any flow is trained.

    A flow trained jointly with a fresh encoder learns plausible cars and ignores the picture. Here
    the encoder must name structure, direction, proportions and colours; the structure flow's
    network, fed no noise, is the head that reads its tokens, and starts the flow. Colours matter
    though no shape depends on them: the latent flow reads the same tokens later. The loss is the
    squared error of the structure latent, azimuth, extents and colours.

    Attributes:
        encoder, reader, heads: networks that are trained; the reader is called with no noise at
            time 0.
        examples: see `ImageExamples`.
        indices: assets to train on.
        batch: pictures a step, each of another asset.
        deviation: standard deviation of the structure latents; their error is measured in it.
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
            "structure": error,
            "azimuth": turn,
            "extents": shape,
            "sides": hue,
            "patches": detail,
        }
        return StepLoss(
            error + 0.5 * turn + 5.0 * shape + hue + 5.0 * detail,
            {name: float(value.detach()) for name, value in logs.items()},
        )


def read_structure(reader: SparseStructureFlowModel, tokens: Tensor) -> Tensor:
    """Structure latents (B, C, r, r, r) that a network reads from image tokens (B, L, C)."""
    config = reader.config
    nothing = tokens.new_zeros(len(tokens), config.in_channels, *[config.resolution] * 3)
    return reader(nothing, tokens.new_zeros(len(tokens)), tokens)


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
