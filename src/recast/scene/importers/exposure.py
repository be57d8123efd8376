"""DriveStudio's affine colours, of which the mean one is written into the scene's colours."""

from __future__ import annotations

import torch
from torch import Tensor

from recast.scene.importers.table import Table


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
