"""What refinement minimises: the vehicle, drawn between its layers, against the image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from recast.actors.refine.layers import Layers
from recast.scene.losses import photometric_loss
from recast.splats import Gaussians, LowPass, rasterize

SSIM_WEIGHT = 0.2
OUTLINE_WEIGHT = 0.5


@dataclass(frozen=True)
class ViewLoss:
    """Terms of one image, each a mean over the pixels that it compares.

    Attributes:
        colour: 0.8 |x - y| + 0.2 (1 - SSIM) on the vehicle.
        outline: |opacity - mask|, weighted by trust, over the vehicle's pixels.
    """

    colour: Tensor
    outline: Tensor

    @property
    def total(self) -> Tensor:
        """The weighted sum."""
        return self.colour + OUTLINE_WEIGHT * self.outline


def view_loss(
    gaussians: Gaussians, low_pass: LowPass, layers: Layers, offset: Tensor | None = None
) -> ViewLoss:
    """Compare a vehicle with one image; differentiable in all but the layers.

    Args:
        gaussians: actor frame.
        low_pass: the filter that they are drawn through.
        offset: (4, 4) correction of the vehicle's pose, in its own frame.
    """
    pose = layers.camera_from_world @ layers.world_from_object
    if offset is not None:
        pose = pose @ offset
    camera = layers.sighting.camera
    drawn = rasterize(
        gaussians, pose, layers.K, camera.width, camera.height,
        eps2d=low_pass.variance, antialiased=low_pass.antialiased,
    )  # fmt: skip
    compared = layers.compared[..., None]
    shown = layers.around(drawn.rgb, drawn.alpha)
    # Beside the vehicle both are the target, so that nothing there is explained by the vehicle.
    shown = compared * shown + (1 - compared) * layers.target
    area = layers.compared.sum().clamp(min=1.0) / layers.compared.numel()
    wanted = layers.mask * layers.through
    missed = (drawn.alpha * layers.through - wanted).abs() * layers.trust
    return ViewLoss(
        photometric_loss(shown, layers.target, SSIM_WEIGHT) / area,
        missed.sum() / layers.compared.sum().clamp(min=1.0),
    )


def mean_loss(
    gaussians: Gaussians, low_pass: LowPass, views: Sequence[Layers],
    offsets: Sequence[Tensor | None],
) -> float:  # fmt: skip
    """Mean loss over images, each weighted as its sighting; nan without one."""
    with torch.no_grad():
        losses = [
            float(view_loss(gaussians, low_pass, view, offset).total) * view.sighting.weight
            for view, offset in zip(views, offsets, strict=True)
        ]
    weight = sum(view.sighting.weight for view in views)
    return sum(losses) / weight if weight else float("nan")
