"""The structured-latent autoencoder: voxel features to latents to Gaussians, judged by pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from recast.recar.assets.asset import TrainingAsset
from recast.recar.assets.store import AssetStore, voxel_features
from recast.recar.autoencoders.structure import normal_divergence
from recast.recar.training.task import StepLoss, StepRandom
from recast.scene.image_metrics import ssim_map
from recast.splats import MIP, Gaussians, Rasterization, rasterize
from recast.trellis.models.slat_decoder_gs import SLatGaussianDecoder
from recast.trellis.models.slat_encoder import SLatEncoder


@dataclass(frozen=True)
class LatentAutoencoderTask:
    """Renders of the decoded Gaussians against the asset's pictures.

    L1 + 0.5 L1 of alpha + 0.2 (1 - SSIM) + a little divergence, on a random background colour, so
    that holes and halos are seen. The published loss has LPIPS instead of the alpha term.

    Attributes:
        encoder, decoder: trained.
        store: assets.
        indices: of those to train on.
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
        gaussians, torch.from_numpy(asset.poses[view]), camera, side, side,
        background=background, eps2d=MIP.variance, antialiased=MIP.antialiased,
    )  # fmt: skip


def picture(asset: TrainingAsset, view: int, background: Tensor) -> tuple[Tensor, Tensor]:
    """(S, S, 3) display colours before a background, and alpha (S, S)."""
    rgba = torch.from_numpy(asset.pictures[view]).float() / 255
    alpha = rgba[..., 3:]
    return rgba[..., :3] * alpha + background * (1 - alpha), alpha[..., 0]
