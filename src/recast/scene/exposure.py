"""Exposure of single images: an affine transform of the composited colours.

Blending is linear: with alpha the sum of the weights, A (sum w c + (1 - alpha) sky) + b equals
sum w (A c + b) + (1 - alpha) (A sky + b). So the mean transform, which views that nobody trained on
get, can be written into a scene's colours. It holds while no Gaussian's colour is clamped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from recast.scene.adam_table import AdamTable
from recast.scene.sky import SkyMap
from recast.scene.street_scene import SceneActor, StreetScene
from recast.scene.views import View
from recast.splats import Gaussians
from recast.splats.sh import C0


class Exposures:
    """A transform [I | 0] + residual (3, 4) for each training view.

    Attributes:
        table: (V, 12) the residuals.
    """

    def __init__(self, views: Sequence[View]) -> None:
        self._rows = {(view.camera_name, view.frame): row for row, view in enumerate(views)}
        self.table = AdamTable(torch.zeros(len(views), 12))

    def applied(self, image: Tensor, view: View) -> tuple[Tensor, Tensor]:
        """The image (H, W, 3) as the view's camera exposed it, and the mean size of the residual.

        Both are differentiable, the second is what a regulariser weighs.
        """
        residual = self.table.value[self._rows[view.camera_name, view.frame]].to(image.device)
        return exposed_colours(image, _affine(residual)), residual.abs().mean()

    def mean(self) -> Tensor:
        """The transform (3, 4) of views that were not trained on."""
        return _affine(self.table.value.detach().mean(dim=0))


def exposed_colours(colours: Tensor, affine: Tensor) -> Tensor:
    """Colours (..., 3) after the transform (3, 4)."""
    return colours @ affine[:, :3].T + affine[:, 3]


def exposed(gaussians: Gaussians, affine: Tensor) -> Gaussians:
    """The Gaussians with the colours' transform (3, 4) in their harmonics."""
    sh = gaussians.sh @ affine[:, :3].T
    # A colour is 0.5 + C0 constant + ...: what A makes of the half goes to the constant as well.
    shift = exposed_colours(torch.full((3,), 0.5), affine) - 0.5
    constant = sh[:, :1] + shift / C0
    return replace(gaussians, sh=torch.cat([constant, sh[:, 1:]], dim=1))


def exposed_scene(scene: StreetScene, affine: Tensor) -> StreetScene:
    """The scene with the colours' transform (3, 4) in all its parts; the sky stays in [0, 1]."""
    return replace(
        scene,
        background=exposed(scene.background, affine),
        actors={name: _exposed_actor(actor, affine) for name, actor in scene.actors.items()},
        sky=SkyMap(exposed_colours(scene.sky.colours, affine).clamp(0, 1)),
    )


def _exposed_actor(actor: SceneActor, affine: Tensor) -> SceneActor:
    appearance = actor.appearance
    if appearance is not None:
        appearance = replace(appearance, waves=appearance.waves @ affine[:, :3].T)
    return replace(actor, gaussians=exposed(actor.gaussians, affine), appearance=appearance)


def _affine(residual: Tensor) -> Tensor:
    return torch.eye(3, 4).to(residual) + residual.view(3, 4)
