"""Where Gaussians are added and taken away during training: adaptive density control.

Kerbl et al. 2023, section 5: rows whose screen-space gradient stays large are cloned where they are
small and split where they are large; nearly transparent rows go.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from recast.splats import Gaussians, RasterMeta
from recast.splats.gaussians import quat_to_matrix

SPLIT_SHRINK = 1.6

Measure = Literal["signed", "absolute_norm", "absolute_l1"]
"""Of a row's screen-space gradient in a view: the length of its sum over pixels (3DGS); or, with
the components' sizes added up over pixels (AbsGS), their length (gsplat) or sum (Street Gaussians).
"""


class GradientStatistics:
    """Mean screen-space gradient of every row over the views that saw it, in NDC units.

    A pixel gradient times half the image size is the gradient in normalised device coordinates, in
    which 3DGS states its thresholds.
    """

    def __init__(self, count: int, device: torch.device | str = "cpu") -> None:
        self.total = torch.zeros(count, device=device)
        self.views = torch.zeros(count, device=device)

    def add(
        self,
        meta: RasterMeta,
        rows: slice,
        into: slice,
        width: int,
        height: int,
        measure: Measure = "signed",
    ) -> None:
        """Count one view: rows `rows` of its meta belong to rows `into` here.

        Args:
            measure: absolute ones need a meta with `means2d_absgrad`.
        """
        gradient = meta.means2d_grad if measure == "signed" else meta.means2d_absgrad
        assert gradient is not None
        x, y = gradient[rows].unbind(dim=1)
        x, y = x * (width / 2), y * (height / 2)
        size = x.abs() + y.abs() if measure == "absolute_l1" else torch.hypot(x, y)
        visible = meta.visible[rows]
        self.total[into] += size * visible  # without visible pixels the gradient is zero, not NaN
        self.views[into] += visible

    def mean(self) -> Tensor:
        """(N,), 0 for rows never seen."""
        return self.total / self.views.clamp(min=1)

    def state_dict(self) -> dict[str, Tensor]:
        """Plain tensors for a checkpoint."""
        return {"total": self.total, "views": self.views}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Go on from `state_dict`."""
        device = self.total.device
        self.total = state["total"].to(device, copy=True)
        self.views = state["views"].to(device, copy=True)


@dataclass(frozen=True)
class DensityChange:
    """A new population: old rows kept, and rows without history.

    Attributes:
        kept: (M,) int64 old rows, ascending.
        born: new Gaussians.
        parents: (B,) int64 old row of each new one.
        left_out: candidates beyond the most that may be added.
    """

    kept: Tensor
    born: Gaussians
    parents: Tensor
    left_out: int


def plan_change(
    gaussians: Gaussians,
    mean_gradient: Tensor,
    *,
    threshold: float,
    most_new: int,
    split_above: float,
    min_opacity: float,
    generator: torch.Generator,
    doomed: Tensor | None = None,
    settled: Tensor | None = None,
) -> DensityChange:
    """Decide on clones, splits and prunes.

    Args:
        mean_gradient: (N,) NDC units.
        threshold: rows above it are candidates, the largest first.
        most_new: most rows that the population may grow by.
        split_above: metres; larger rows are split, smaller ones cloned.
        min_opacity: rows below it are taken away.
        generator: places the halves of split rows.
        doomed: (N,) bool, rows to take away besides those.
        settled: (N,) bool, rows that are neither taken away nor added to.
    """
    sigma = gaussians.log_scales.detach().amax(dim=1).exp()
    gone = torch.sigmoid(gaussians.logit_opacities.detach()) < min_opacity
    if doomed is not None:
        gone = gone | doomed
    wanted = torch.where(gone, 0.0, mean_gradient)
    if settled is not None:
        gone, wanted = gone & ~settled, torch.where(settled, 0.0, wanted)
    candidates = int((wanted > threshold).sum())
    count = min(candidates, max(most_new, 0))
    chosen = wanted.topk(count).indices.sort().values
    split = chosen[sigma[chosen] > split_above]
    clone = chosen[sigma[chosen] <= split_above]
    gone[split] = True
    parents = torch.cat([clone, split, split])
    born = gaussians.detach().select(parents)
    return DensityChange(
        kept=(~gone).nonzero()[:, 0],
        born=_spread_splits(born, len(clone), generator),
        parents=parents,
        left_out=candidates - count,
    )


def _spread_splits(born: Gaussians, clones: int, generator: torch.Generator) -> Gaussians:
    """Move the halves of split rows to places drawn from their parent, and shrink them."""
    sigma = born.log_scales[clones:].exp()
    noise = torch.randn(sigma.shape, generator=generator).to(sigma.device) * sigma
    turn = quat_to_matrix(torch.nn.functional.normalize(born.quats[clones:], dim=1))
    means, log_scales = born.means.clone(), born.log_scales.clone()
    means[clones:] += (turn @ noise[..., None])[..., 0]
    log_scales[clones:] -= float(torch.tensor(SPLIT_SHRINK).log())
    return Gaussians(means, born.quats, log_scales, born.logit_opacities, born.sh)
