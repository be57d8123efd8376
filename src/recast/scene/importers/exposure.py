"""DriveStudio's affine colours, of which the mean one can be written into a scene's colours.

Blending is linear: with alpha the sum of the weights, A (sum w c + (1 - alpha) sky) + b equals
sum w (A c + b) + (1 - alpha) (A sky + b). It holds while no Gaussian's colour is clamped.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from recast.scene.importers.table import Table
from recast.splats import Gaussians
from recast.splats.sh import C0


def mean_affine(table: Table) -> Tensor:
    """The colour transform (3, 4) that the trainer uses for views it was not trained on.

    [I | 0] plus a network's output for the mean of the images' embeddings: one hidden layer with
    ReLU.

    Raises:
        InputError: a tensor is missing, of another shape, or not finite.
    """
    embeddings = table.tensor("embedding.weight", None, None)
    if len(embeddings) == 0:
        raise table.fault("embedding.weight", "has no rows")
    inner = table.tensor("decoder.0.weight", None, embeddings.shape[1])
    hidden = torch.relu(inner @ embeddings.mean(dim=0) + table.tensor("decoder.0.bias", len(inner)))
    outer = table.tensor("decoder.2.weight", 12, len(inner))
    residual = outer @ hidden + table.tensor("decoder.2.bias", 12)
    return torch.eye(3, 4) + residual.view(3, 4)


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
