"""Colour of an actor over its time: a Fourier series in the constant harmonic (Street Gaussians).

A share of the actor's time, 0 at its first label and 1 at its last, stands for t.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from recast.logs import Trajectory
from recast.splats import Gaussians
from recast.splats.gaussians import LARGEST


def fourier_basis(share: float, terms: int) -> Tensor:
    """(F,) float32: 1, sin 2 pi t, cos 2 pi t, sin 4 pi t, cos 4 pi t, ... at a share t of time.

    Street Gaussians' basis: cos(pi t k) for even k, sin(pi t (k + 1)) for odd k.
    """
    return torch.tensor(
        [
            math.cos(math.pi * share * k) if k % 2 == 0 else math.sin(math.pi * share * (k + 1))
            for k in range(terms)
        ]
    )


def share_of(trajectory: Trajectory, timestamp_us: int) -> float:
    """The share in [0, 1] of a trajectory's time that has passed."""
    first, last = (int(time) for time in trajectory.timestamps_us[[0, -1]])
    return min(max((timestamp_us - first) / max(last - first, 1), 0.0), 1.0)


def coloured(gaussians: Gaussians, waves: Tensor, share: float) -> Gaussians:
    """Add the time-dependent part (N, F - 1, 3) to the constant harmonic; differentiable."""
    basis = fourier_basis(share, waves.shape[1] + 1)[1:].to(waves)
    constant = gaussians.sh[:, :1] + torch.einsum("k,nkc->nc", basis, waves)[:, None]
    return replace(gaussians, sh=torch.cat([constant, gaussians.sh[:, 1:]], dim=1))


@dataclass(frozen=True)
class Appearance:
    """How the colours of an actor's Gaussians go on from the moment at which they are stored.

    Attributes:
        waves: (N, F - 1, 3) coefficients of the basis but its constant.
        frozen_share: share of the actor's time whose colours its Gaussians have: those of every
            use that is tied to no time of the recording.
    """

    waves: Tensor
    frozen_share: float

    def validate(self, where: str, count: int) -> None:
        """Raise ValueError naming the member at fault of an actor `where` of `count` Gaussians."""
        shape = tuple(self.waves.shape)
        if len(shape) != 3 or shape[0] != count or shape[2] != 3:
            raise ValueError(f"{where}.waves: expected ({count}, F - 1, 3), got {shape}")
        if not bool((self.waves.abs() < LARGEST).all()):  # also NaN
            raise ValueError(f"{where}.waves: a value is not finite, or out of range")
        if not 0 <= self.frozen_share <= 1:
            raise ValueError(f"{where}.frozen_share: {self.frozen_share} is not within [0, 1]")

    def at(self, frozen: Gaussians, share: float) -> Gaussians:
        """The Gaussians with the colours of another share of the time."""
        return coloured(coloured(frozen, -self.waves, self.frozen_share), self.waves, share)


def frozen(
    gaussians: Gaussians, waves: Tensor, share: float
) -> tuple[Gaussians, Appearance | None]:
    """Gaussians with the colours of a share of the time, and how those go on, if they change."""
    if waves.shape[1] == 0:
        return gaussians, None
    return coloured(gaussians, waves, share), Appearance(waves, share)
