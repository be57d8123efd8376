"""What a refinement moves: the whole vehicle, then every Gaussian, and how far each may go.

The whole: place, size, a smooth field of offsets, and the poses of its track. It is symmetric to
the plane between left and right: the side that was seen bends the other.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
import torch.nn.functional as functional
from numpy.typing import NDArray
from torch import Tensor

from recast.arrays import Array
from recast.splats import Gaussians, concatenate
from recast.splats.gaussians import quat_multiply, quat_to_matrix

_NODES = (6, 3, 4)  # along, from the middle to a side, up
_ROOM = 1.1  # size of the lattice over that of the box
KNOT_US = 400_000
"""Time between knots of the pose offsets, microseconds."""
FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh")
_SMALLEST, _LARGEST = math.log(0.006), math.log(0.25)  # metres, as logarithms
_APART, _SHORTER = 0.6, 0.65
_FINEST = 0.012  # metres: smaller ones are not split


class Bend:
    """p -> rotate_z(turn) (exp(grow) p + offsets(p)) + move, offsets from a coarse lattice.

    Args:
        size: (3,) size of the box, metres.

    Attributes:
        move: (3,) metres. turn: (1,) radians. grow: (3,) logarithms.
        offsets: (3, 4, 3, 6) metres at the lattice's nodes (up, across, along).
    """

    def __init__(self, size: Array) -> None:
        self._half = torch.from_numpy(np.asarray(size) * _ROOM / 2).float()
        self.move = torch.zeros(3, requires_grad=True)
        self.turn = torch.zeros(1, requires_grad=True)
        self.grow = torch.zeros(3, requires_grad=True)
        self.offsets = torch.zeros(3, *_NODES[::-1], requires_grad=True)

    def field(self, points: Tensor) -> Tensor:
        """Offsets (N, 3) at points (N, 3); across they change sign with the side."""
        side = torch.where(points[:, 1] < 0, -1.0, 1.0)
        place = points / self._half
        place = torch.stack([place[:, 0], 2 * place[:, 1].abs() - 1, place[:, 2]], -1)
        found = functional.grid_sample(
            self.offsets[None], place.clamp(-1, 1)[None, :, None, None], align_corners=True
        )[0, :, :, 0, 0].T
        one = torch.ones_like(side)
        return found * torch.stack([one, side, one], -1)

    def points(self, points: Tensor) -> Tensor:
        """Points (N, 3) after the move; differentiable."""
        bent = points * self.grow.exp() + self.field(points)
        c, s = self.turn.cos(), self.turn.sin()
        x, y, z = bent.unbind(-1)
        return torch.stack([c * x - s * y, s * x + c * y, z], -1) + self.move

    def __call__(self, gaussians: Gaussians) -> Gaussians:
        """Gaussians after the move; harmonics are left as they are, the turn is a small one."""
        half = self.turn / 2
        none = torch.zeros(2)
        turn = torch.cat([half.cos(), none, half.sin()]).expand(len(gaussians), 4)
        return replace(
            gaussians,
            means=self.points(gaussians.means),
            quats=quat_multiply(turn, gaussians.quats),
            log_scales=gaussians.log_scales + self.grow.mean(),
        )

    def parameters(self) -> dict[str, Tensor]:
        """Leaf tensors by name."""
        return {"move": self.move, "turn": self.turn, "grow": self.grow, "offsets": self.offsets}

    def strain(self) -> Tensor:
        """How far the lattice bends: mean squares of offsets (over 4 cm) and of their steps."""
        steps = [(self.offsets.diff(dim=d) / 0.02).square().mean() for d in (1, 2, 3)]
        sizes = (self.offsets / 0.04).square().mean() + (self.grow / 0.05).square().mean()
        return sizes + torch.stack(steps).mean()


class PoseOffsets:
    """Small corrections of a track's poses: (forward, left, up, yaw) in the vehicle's frame.

    Piecewise linear between knots 0.4 s apart. Their mean over the sightings is taken out: what all
    have in common is the vehicle's place in its box.

    Args:
        times: (T,) int64 times of the sightings, microseconds.
    """

    def __init__(self, times: NDArray[np.int64]) -> None:
        first, last = int(times.min()), int(times.max())
        count = max((last - first) // KNOT_US + 1, 1) + 1
        self.knots = np.linspace(first, max(last, first + 1), count)
        self.values = torch.zeros(count, 4, requires_grad=True)
        self._mean = torch.from_numpy(
            np.stack([self._weights(int(time)) for time in times]).mean(axis=0)
        ).float()

    def _weights(self, time: int) -> Array:
        """(K,) share of each knot at a time; the ends are held beyond them."""
        position = float(np.interp(time, self.knots, np.arange(len(self.knots))))
        weights = np.zeros(len(self.knots))
        left = min(int(position), len(weights) - 2)
        weights[left], weights[left + 1] = 1 - (position - left), position - left
        return weights

    def at(self, time: int) -> Tensor:
        """`object_from_corrected` (4, 4) at a time; differentiable."""
        weights = torch.from_numpy(self._weights(time)).float() - self._mean
        x, y, z, yaw = (weights @ self.values).unbind()
        c, s, zero, one = yaw.cos(), yaw.sin(), torch.zeros(()), torch.ones(())
        return torch.stack(
            [c, -s, zero, x, s, c, zero, y, zero, zero, one, z, zero, zero, zero, one]
        ).view(4, 4)

    def roughness(self) -> Tensor:
        """Mean squares of the offsets over 3 cm and 0.3 degrees, and of their steps over half."""
        spread = torch.tensor([0.03, 0.03, 0.015, 0.005])
        steps = self.values.diff(dim=0) / (0.5 * spread)
        return (self.values / spread).square().mean() + steps.square().mean()


class FreeGaussians:
    """prior + freedom x change, field by field: Adam's steps shrink with the freedom.

    Args:
        prior: Gaussians in the actor frame; harmonics of any degree become at least those of degree
            1.
        freedom: (N,) in [0, 1].

    Attributes:
        changes: leaf tensors by field.
    """

    def __init__(self, prior: Gaussians, freedom: Tensor) -> None:
        if prior.sh.shape[1] < 4:
            room = (0, 0, 0, 4 - prior.sh.shape[1])
            prior = replace(prior, sh=torch.nn.functional.pad(prior.sh, room))
        self.prior, self._freedom = prior.detach(), freedom
        self.changes = {
            name: torch.zeros_like(getattr(self.prior, name), requires_grad=True) for name in FIELDS
        }

    def _change(self, name: str) -> Tensor:
        change = self.changes[name]
        return self._freedom.view(-1, *[1] * (change.ndim - 1)) * change

    def __call__(self) -> Gaussians:
        """The Gaussians as they stand; differentiable in the changes."""
        value = {name: getattr(self.prior, name) + self._change(name) for name in FIELDS}
        value["log_scales"] = value["log_scales"].clamp(_SMALLEST, _LARGEST)
        return Gaussians(**value)

    def strain(self) -> Tensor:
        """Pull towards the prior: squares of shifts over 5 cm, of scales, of degree one."""
        moved = (self._change("means") / 0.05).square().mean()
        grown = self._change("log_scales").square().mean()
        turned = self._change("sh")[:, 1:].square().mean()
        return 0.2 * moved + 0.05 * grown + 0.2 * turned


def split_rows(gaussians: Gaussians, chosen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Rows that stay whole, and twice those that are to be cut: chosen (N,) bool and not fine."""
    cut = chosen & (gaussians.log_scales.amax(dim=1) > math.log(_FINEST))
    rows = cut.nonzero()[:, 0]
    return (~cut).nonzero()[:, 0], rows, rows


def split(gaussians: Gaussians, whole: Tensor, first: Tensor, second: Tensor) -> Gaussians:
    """Gaussians cut in two along their longest axis; rows as `split_rows` gives them.

    Halves lie 0.6 deviations to either side and are 0.65 times as long: together they keep the
    centre and 0.88 of the deviation (0.6^2 + 0.65^2 = 0.88^2).
    """
    parts = [gaussians.select(whole)]
    for rows, way in ((first, 1), (second, -1)):
        cut = gaussians.select(rows)
        longest = cut.log_scales.argmax(dim=1)[:, None]
        axes = quat_to_matrix(cut.quats)
        axis = axes.gather(2, longest[:, None].expand(-1, 3, 1))[:, :, 0]
        step = _APART * cut.log_scales.amax(dim=1, keepdim=True).exp() * axis
        shorter = torch.full_like(cut.log_scales[:, :1], math.log(_SHORTER))
        parts.append(
            replace(
                cut,
                means=cut.means + way * step,
                log_scales=cut.log_scales.scatter_add(1, longest, shorter),
            )
        )
    return concatenate(parts)
