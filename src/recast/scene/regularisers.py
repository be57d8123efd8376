"""What keeps a scene plausible where no image says so."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from recast.scene.poses import TrackPoses

SHARPEST = 10.0
"""Longest to shortest axis of a Gaussian that costs nothing (OmniRe)."""
SHARP_SHAPE_EVERY = 10
"""Steps between the costs of sharp shapes (OmniRe)."""
SMOOTH_OVER = 5
"""Track positions are compared with those up to this many labels before and after (OmniRe)."""


def sharp_shape(log_scales: Tensor) -> Tensor:
    """mean(max(longest / shortest axis, 10) - 10) of (N, 3) log scales: needles make streaks."""
    ratio = (log_scales.amax(dim=1) - log_scales.amin(dim=1)).exp()
    return (ratio - SHARPEST).clamp(min=0).mean()


def actor_opacity(alpha: Tensor, inside: Tensor) -> Tensor:
    """Opacity of the actors alone: all or nothing in their boxes, nothing beside them.

    Street Gaussians' object term: -(a ln a + (1 - a) ln(1 - a)) inside, -ln(1 - a) outside, mean
    over the image.

    Args:
        alpha: (H, W) of actors rendered without the background.
        inside: (H, W) bool, in an actor's box.
    """
    a = alpha.clamp(1e-6, 1 - 1e-6)
    empty = -(1 - a).log()
    return torch.where(inside, -a * a.log() + (1 - a) * empty, empty).mean()


class TrackSmoothness:
    """How far tracks are from even motion: |x(t + k) + x(t - k) - 2 x(t)| for k = 1..5 labels.

    Labels are not all evenly spaced (held-out ones are missing), so the middle is compared with the
    place at its own time between the two others.
    """

    def __init__(self, poses: TrackPoses) -> None:
        self._poses = poses
        starts, middles, ends, weights = [], [], [], []
        positions = [np.zeros((0, 3))]
        for row, times, logged in poses.knots():
            positions.append(logged)
            for k in range(1, SMOOTH_OVER + 1):
                middle = np.arange(k, len(times) - k)
                before, after = times[middle - k], times[middle + k]
                starts.append(row + middle - k)
                middles.append(row + middle)
                ends.append(row + middle + k)
                weights.append((times[middle] - before) / (after - before))
        self._positions = torch.from_numpy(np.concatenate(positions))
        none = [np.zeros(0, np.int64)]
        self._start, self._middle, self._end = (
            torch.from_numpy(np.concatenate(none + part)) for part in (starts, middles, ends)
        )
        self._weight = torch.from_numpy(np.concatenate([np.zeros(0), *weights]))[:, None]

    def loss(self) -> Tensor:
        """Mean over labels and k, metres; 0 without a track of three labels."""
        if len(self._middle) == 0:
            return torch.zeros(())
        x = self._positions + self._poses.table.value[:, :3].double()
        between = torch.lerp(x[self._start], x[self._end], self._weight)
        return 2 * (between - x[self._middle]).abs().sum(dim=1).mean().float()
