"""What each of the two flows learns: dense structure latents, or latents on voxels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from recast.errors import InputError
from recast.recar.targets import Target
from recast.trellis.flow import Velocity
from recast.trellis.models.slat_flow import SLatFlowModel
from recast.trellis.models.ss_flow import SparseStructureFlowModel
from recast.trellis.sparse import SparseTensor


@dataclass(frozen=True)
class FlowData:
    """A batch as the flow-matching loss takes it.

    Attributes:
        x0: dense (B, ...) or sparse (T, C) data.
        batch: (T,) sample of each row of sparse data.
        velocity: the network on this batch.
    """

    x0: Tensor
    batch: Tensor | None
    velocity: Velocity


class Flow(Protocol):
    """One of the two flows."""

    @property
    def model(self) -> torch.nn.Module:
        """What is trained."""
        ...

    def load(self, voxels: int) -> int:
        """How much work a target of so many voxels is, in any unit."""
        ...

    def data(self, targets: Sequence[Target]) -> FlowData:
        """A batch on the network's device."""
        ...


@dataclass(frozen=True)
class StructureFlow:
    """Structure latents, as sampled, whatever their spread: the published ones are not normalised.

    Attributes:
        model: the network.
    """

    model: SparseStructureFlowModel

    def load(self, voxels: int) -> int:
        """All alike."""
        return 1

    def data(self, targets: Sequence[Target]) -> FlowData:
        """Dense (B, C, r, r, r).

        Raises:
            InputError: a target's structure is of another shape.
        """
        config = self.model.config
        shape = (config.in_channels, *[config.resolution] * 3)
        for one in targets:
            if one.structure.shape != shape:
                raise InputError(
                    "targets", "structure", f"is {one.structure.shape}, the network takes {shape}",
                    "make the targets with a model of the same size",
                )  # fmt: skip
        stacked = torch.stack([torch.from_numpy(one.structure) for one in targets])
        return FlowData(stacked.to(self.model.device), None, self.model)


@dataclass(frozen=True)
class LatentFlow:
    """Structured latents on the voxels of the target, normalised as the checkpoint says.

    Attributes:
        model: the network.
        mean, std: (C,) of the checkpoint.
    """

    model: SLatFlowModel
    mean: Tensor
    std: Tensor

    def load(self, voxels: int) -> int:
        """Voxels."""
        return voxels

    def data(self, targets: Sequence[Target]) -> FlowData:
        """Sparse (T, C), the voxels of all samples one after another."""
        raw = SparseTensor.stack(
            [torch.from_numpy(one.coords).int() for one in targets],
            [torch.from_numpy(one.latent) for one in targets],
        ).to(self.model.device)
        start = raw.with_feats((raw.feats - self.mean) / self.std)

        def velocity(x: Tensor, t: Tensor, cond: Tensor) -> Tensor:
            out: SparseTensor = self.model(start.with_feats(x), t, cond)
            return out.feats

        return FlowData(start.feats, start.batch, velocity)
