"""Where a vehicle's looks come from: seen by the log, mirrored from what was seen, or invented."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Shares:
    """Where each of N Gaussians comes from; with the invented share they add up to one.

    Attributes:
        seen: (N,) float32 in [0, 1], from images of it.
        mirrored: (N,) float32 in [0, 1], from images of the other side.
    """

    seen: Tensor
    mirrored: Tensor

    def __len__(self) -> int:
        return len(self.seen)

    @property
    def invented(self) -> Tensor:
        """(N,) float32 in [0, 1], from the generator alone."""
        return (1 - self.seen - self.mirrored).clamp(0, 1)

    @property
    def columns(self) -> Tensor:
        """(N, 3) seen, mirrored, invented: as colours, red, green and blue."""
        return torch.stack([self.seen, self.mirrored, self.invented], dim=-1)

    def select(self, index: Tensor) -> Shares:
        """Those of the Gaussians at `index`: (M,) int64 or a (N,) bool mask."""
        return Shares(self.seen[index], self.mirrored[index])

    def fault(self, count: int) -> tuple[str, str] | None:
        """The field at fault and what is wrong with it; None for shares of `count` Gaussians."""
        for name in ("seen", "mirrored"):
            value: Tensor = getattr(self, name)
            if tuple(value.shape) != (count,) or value.dtype != torch.float32:
                return (
                    name,
                    f"shape {tuple(value.shape)} {value.dtype}, expected ({count},) float32",
                )
            if not bool(((value >= 0) & (value <= 1)).all()):  # also NaN
                return name, "holds a value outside of [0, 1]"
        if not bool((self.seen + self.mirrored <= 1 + 1e-5).all()):
            return "mirrored", "seen and mirrored are more than one together"
        return None
