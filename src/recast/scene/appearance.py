"""How Gaussians look: actors over their time, their side that no camera sees, images' exposures.

Colours are a Fourier series in the constant harmonic. A share of the actor's time, 0 at its first
label and 1 at its last, stands for t. Vehicles are symmetric, the flip prior of Street Gaussians: a
reflection at the plane between left and right, y -> -y in the box frame, carries a Gaussian to
where an equal one is expected on the side that no camera sees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from recast.logs import Trajectory
from recast.splats import Gaussians, concatenate
from recast.splats.gaussians import LARGEST
from recast.splats.sh import C0


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


def coloured(gaussians: Gaussians, fourier: Tensor, share: float) -> Gaussians:
    """Add the time-dependent part (N, F - 1, 3) to the constant harmonic; differentiable."""
    basis = fourier_basis(share, fourier.shape[1] + 1)[1:].to(fourier)
    constant = gaussians.sh[:, :1] + torch.einsum("k,nkc->nc", basis, fourier)[:, None]
    return replace(gaussians, sh=torch.cat([constant, gaussians.sh[:, 1:]], dim=1))


@dataclass(frozen=True)
class Appearance:
    """How the colours of an actor's Gaussians go on from the moment at which they are stored.

    Attributes:
        fourier: (N, F - 1, 3) coefficients of the basis but its constant.
        frozen_share: share of the actor's time whose colours its Gaussians have: those of every
            use that is tied to no time of the recording.
    """

    fourier: Tensor
    frozen_share: float

    def validate(self, where: str, count: int) -> None:
        """Raise ValueError naming the member at fault of an actor `where` of `count` Gaussians."""
        shape = tuple(self.fourier.shape)
        if len(shape) != 3 or shape[0] != count or shape[2] != 3:
            raise ValueError(f"{where}.fourier: expected ({count}, F - 1, 3), got {shape}")
        if not bool((self.fourier.abs() < LARGEST).all()):  # also NaN
            raise ValueError(f"{where}.fourier: a value is not finite, or out of range")
        if not 0 <= self.frozen_share <= 1:
            raise ValueError(f"{where}.frozen_share: {self.frozen_share} is not within [0, 1]")

    def at(self, frozen: Gaussians, share: float) -> Gaussians:
        """The Gaussians with the colours of another share of the time."""
        return coloured(coloured(frozen, -self.fourier, self.frozen_share), self.fourier, share)


def frozen(
    gaussians: Gaussians, fourier: Tensor, share: float
) -> tuple[Gaussians, Appearance | None]:
    """Gaussians with the colours of a share of the time, and how those go on, if they change."""
    if fourier.shape[1] == 0:
        return gaussians, None
    return coloured(gaussians, fourier, share), Appearance(fourier, share)


def mirrored(gaussians: Gaussians, chosen: Tensor) -> Gaussians:
    """Reflect the rows of a (N,) bool mask at the plane y = 0; differentiable.

    A reflection is no rotation, but diag(-1, 1, -1), the half turn about y, makes the same
    covariance of every Gaussian as diag(1, -1, 1). View-dependent colour is reflected too: of the
    real harmonics those of negative order are odd in y.
    """
    sign = torch.where(chosen, -1.0, 1.0).to(gaussians.means)
    one = torch.ones_like(sign)
    w, x, y, z = gaussians.quats.unbind(-1)
    turned = torch.stack([-y, z, w, -x], dim=-1)  # (0, 0, 1, 0) times the quaternion
    return replace(
        gaussians,
        means=gaussians.means * torch.stack([one, sign, one], dim=-1),
        quats=torch.where(chosen[:, None], turned, gaussians.quats),
        sh=torch.where(chosen[:, None, None], gaussians.sh * _parity(gaussians), gaussians.sh),
    )


def with_other_side(gaussians: Gaussians) -> Gaussians:
    """The side with more Gaussians, and its reflection beside all that was there."""
    left = gaussians.means[:, 1] > 0
    side = left if int(left.sum()) * 2 >= len(left) else ~left
    fuller = gaussians.select(side)
    everywhere = torch.ones(len(fuller), dtype=torch.bool, device=side.device)
    return concatenate([gaussians, mirrored(fuller, everywhere)])


def _parity(gaussians: Gaussians) -> Tensor:
    """(K, 1) factors of the harmonics under y -> -y: -1 for orders below zero."""
    degrees = range(gaussians.sh_degree + 1)
    orders = [order for degree in degrees for order in range(-degree, degree + 1)]
    return torch.tensor([-1.0 if order < 0 else 1.0 for order in orders]).to(gaussians.sh)[:, None]


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
