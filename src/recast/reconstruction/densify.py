"""What befalls Gaussians between steps: density control, its limit, and even ground as a sheet."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.core.records import Record
from recast.logs import GroundHeight, Track
from recast.reconstruction.config import Measure, SceneConfig
from recast.reconstruction.settings import INIT, OPTIM
from recast.reconstruction.views import TrainingView
from recast.splats import Gaussians, RasterMeta, RowAdam, concatenate, morton_order
from recast.splats.gaussians import quat_multiply, quat_to_matrix

if TYPE_CHECKING:
    from recast.reconstruction.step import TrainableScene

FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh")
BUDGET_FILE = "budget.json"
BUDGET_VERSION = 1


def rows(gaussians: Gaussians) -> dict[str, Tensor]:
    """The fields by name."""
    return {name: getattr(gaussians, name) for name in FIELDS}


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
    log_scales[clones:] -= float(torch.tensor(OPTIM.split_shrink).log())
    return Gaussians(means, born.quats, log_scales, born.logit_opacities, born.sh)


def control_density(
    model: TrainableScene,
    tracks: Mapping[str, Track],
    config: SceneConfig,
    generator: torch.Generator,
    oversize: bool = False,
    bodies: Collection[str] = (),
) -> bool:
    """Clone, split and prune; background rows are put back into Morton order.

    The room below `max_gaussians` is shared in proportion to the parts' sizes. Where it is None
    there is no bound: `train_scene` puts the drive's own there.

    Args:
        oversize: whether rows above `prune_above_m` and `actor_prune_above_m` go as well.
        bodies: actors whose rows stay as many as their vertices are.

    Returns:
        Whether `max_gaussians` kept rows from being added.
    """
    limit = config.prune_above_m if oversize else math.inf
    actor_limit = config.actor_prune_above_m if oversize else math.inf
    total = len(model.background) + len(model.local)
    most = math.inf if config.max_gaussians is None else config.max_gaussians
    room = max(most - total, 0) / max(total, 1)
    growth = min(config.densify_growth, room)
    background = plan_change(
        model.background,
        model.background_statistics.mean(),
        threshold=config.densify_gradient,
        most_new=int(growth * len(model.background)),
        split_above=config.split_above_m,
        min_opacity=config.prune_opacity,
        generator=generator,
        doomed=_larger(model.background, limit),
    )
    local = plan_change(
        model.local,
        model.local_statistics.mean(),
        threshold=config.actor_densify_gradient or config.densify_gradient,
        most_new=int(growth * len(model.local)),
        split_above=config.actor_split_above_m,
        min_opacity=config.prune_opacity,
        generator=generator,
        doomed=~inside_boxes(model, tracks) | _larger(model.local, actor_limit),
        settled=_rows_of(model, bodies),
    )
    new_background = _merge(model.background, background)
    order = morton_order(new_background.means)
    new_local = _merge(model.local, local)
    origin = torch.cat([local.kept, local.parents])
    owner = model.owner[origin.cpu()]
    by_owner = owner.argsort(stable=True)
    fourier = model.fourier[origin][by_owner]
    model.place(new_background.select(order), new_local.select(by_owner), owner[by_owner], fourier)
    _follow(model.background_adam, background, order, rows(model.background))
    _follow(model.local_adam, local, by_owner, model.local_parameters())
    device = model.background.means.device
    model.background_statistics = GradientStatistics(len(model.background), device)
    model.local_statistics = GradientStatistics(len(model.local), device)
    return room < config.densify_growth and background.left_out + local.left_out > 0


def reset_opacities(model: TrainableScene) -> None:
    """Lower all opacities to `reset_opacity`; what is needed grows back, what is not is pruned.

    Kerbl et al. 2023, section 5.2: against floaters close to the cameras. Moments are forgotten.
    """
    limit = math.log(OPTIM.reset_opacity / (1 - OPTIM.reset_opacity))
    parts = ((model.background, model.background_adam), (model.local, model.local_adam))
    for gaussians, adam in parts:
        with torch.no_grad():
            gaussians.logit_opacities.clamp_(max=limit)
        adam.forget("logit_opacities")


def _rows_of(model: TrainableScene, names: Collection[str]) -> Tensor | None:
    """(A,) bool: actor rows of some actors; None for no actors."""
    if not names:
        return None
    chosen = torch.tensor([name in names for name in model.track_ids])
    return chosen[model.owner].to(model.local.means.device)


def _larger(gaussians: Gaussians, limit: float) -> Tensor:
    """(N,) bool: rows whose longest standard deviation is above `limit` metres."""
    return gaussians.log_scales.detach().amax(dim=1).exp() > limit


def inside_boxes(model: TrainableScene, tracks: Mapping[str, Track]) -> Tensor:
    """(A,) bool: actor rows whose centre lies in its box (grown to the sides and upwards)."""
    means = model.local.means.detach()
    if len(means) == 0:
        return torch.zeros(0, dtype=torch.bool, device=means.device)
    sizes = torch.stack([torch.from_numpy(tracks[name].size) for name in model.track_ids]).float()
    half = (sizes[model.owner] / 2).to(means.device)
    high = half + OPTIM.leave_box_m
    low = -high
    low[:, 2] = -half[:, 2] - OPTIM.leave_box_down_m
    return ((means <= high) & (means >= low)).all(dim=1)


def _merge(old: Gaussians, change: DensityChange) -> Gaussians:
    return concatenate([old.detach().select(change.kept), change.born])


def _follow(
    adam: RowAdam, change: DensityChange, order: Tensor, parameters: dict[str, Tensor]
) -> None:
    """Carry the moments of the kept rows along; new rows start without history."""
    adam.select(change.kept)
    adam.append(len(change.born))
    adam.select(order)
    adam.params = parameters


class GroundSheet:
    """The surface of even ground that the LiDAR found, and the Gaussians that lie flat on it.

    Images from one lane do not tell how high a Gaussian of the road is: along its rays it may lie
    anywhere. Left alone, a road becomes a cloud of 10 cm, and a lane marking seen from another lane
    falls into strips. The LiDAR knows the surface to a centimetre or two.

    Args:
        ground: heights; NaN where the ground is not even, where Gaussians are left alone.
        tolerance_m: most distance of a centre from the surface, metres.
    """

    def __init__(
        self, ground: GroundHeight, tolerance_m: float, device: torch.device | str = "cpu"
    ) -> None:
        self._tolerance, self._cell = tolerance_m, ground.cell
        self._origin = torch.from_numpy(ground.origin).to(device, torch.float32)
        self._height = torch.from_numpy(ground.height).to(device, torch.float32)

    def surface(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Heights (N,) and upward unit normals (N, 3) of the surface under points (N, >= 2).

        Bilinear between the centres of four cells; NaN where one of them is not even.
        """
        column, x, row, y, inside = self._cells(points)
        h00, h10 = self._height[row, column], self._height[row, column + 1]
        h01, h11 = self._height[row + 1, column], self._height[row + 1, column + 1]
        along_x = torch.lerp(h10 - h00, h11 - h01, y) / self._cell
        along_y = torch.lerp(h01 - h00, h11 - h10, x) / self._cell
        height = torch.lerp(torch.lerp(h00, h10, x), torch.lerp(h01, h11, x), y)
        normal = torch.stack([-along_x, -along_y, torch.ones_like(height)], dim=1)
        height = torch.where(inside, height, math.nan)
        return height, torch.nn.functional.normalize(normal, dim=1)

    def _perhaps_near(self, points: Tensor) -> Tensor:
        """Rows of points within reach of the surface, and a few more: cheap, by a single cell."""
        column, _, row, _, inside = self._cells(points)
        above = (points[:, 2] - self._height[row, column]).abs()
        return torch.nonzero(inside & (above < 2 * OPTIM.ground_reach_m))[:, 0]

    def _cells(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Column and share of the next one, row and share of the next one, whether all exist."""
        column_at, row_at = ((points[:, :2] - self._origin) / self._cell).unbind(dim=1)
        column, x, in_columns = _between(column_at, self._height.shape[1])
        row, y, in_rows = _between(row_at, self._height.shape[0])
        return column, x, row, y, in_columns & in_rows

    @torch.no_grad()
    def settle(self, gaussians: Gaussians) -> None:
        """Move Gaussians near the surface onto it, in place, their thinnest axis upright.

        Centres end within the tolerance of the surface, in height; the thinnest axis turns the
        shortest way to its normal and is at most `ground_thickness_m`. Colours and opacities stay.
        """
        rows = self._perhaps_near(gaussians.means)
        height, normal = self.surface(gaussians.means[rows])
        above = gaussians.means[rows, 2] - height
        near = torch.nonzero(above.abs() < OPTIM.ground_reach_m)[:, 0]  # NaN is not near
        rows, height, normal = rows[near], height[near], normal[near]
        held = above[near].clamp(-self._tolerance, self._tolerance)
        gaussians.means[rows, 2] = height + held
        scales = gaussians.log_scales[rows]
        thinnest = scales.argmin(dim=1, keepdim=True)
        gaussians.quats[rows] = _upright(gaussians.quats[rows], thinnest[:, 0], normal)
        thin = scales.gather(1, thinnest).clamp(max=math.log(OPTIM.ground_thickness_m))
        gaussians.log_scales[rows] = scales.scatter(1, thinnest, thin)


def _between(at: Tensor, cells: int) -> tuple[Tensor, Tensor, Tensor]:
    """First of the two cells (N,) about each place, the share of the second, whether both exist."""
    first = at.floor()
    inside = (first >= 0) & (first < cells - 1)
    return torch.where(inside, first, 0).long(), at - first, inside


def _upright(quats: Tensor, axis: Tensor, normal: Tensor) -> Tensor:
    """Quaternions (N, 4) turned the shortest way until an axis (N,) of each is along a normal.

    From unit vector a to b turns (1 + a . b, a x b), normalised; either end of the axis will do.
    """
    columns = quat_to_matrix(quats)
    now = columns.gather(2, axis[:, None, None].expand(-1, 3, 1))[..., 0]
    cosine = (now * normal).sum(dim=1, keepdim=True)
    now = torch.where(cosine < 0, -now, now)
    turn = torch.cat([1 + cosine.abs(), torch.linalg.cross(now, normal)], dim=1)
    return quat_multiply(torch.nn.functional.normalize(turn, dim=1), quats)


class Budget(Record):
    """Contents of budget.json: how many Gaussians there may be, and what came of it.

    Attributes:
        most_gaussians: the limit.
        named: whether the configuration named it; else it was derived from the next two.
        area_m2: street within `street_reach_m` of the drive.
        training_pixels: pixels of all training images at the scale of the training.
        first_found, first_kept: first points before and after they were thinned to the limit.
        limited_from: step of the first change of the population that the limit cut short, or None.
        limited_changes: number of changes that the limit cut short.
    """

    version: int = BUDGET_VERSION
    most_gaussians: int
    named: bool
    area_m2: float
    training_pixels: int
    first_found: int = 0
    first_kept: int = 0
    limited_from: int | None = None
    limited_changes: int = 0

    @property
    def was_met(self) -> bool:
        """Whether the limit kept anything from being added."""
        return self.limited_changes > 0 or self.first_kept < self.first_found

    def explain(self) -> str:
        """One line for people."""
        how = "max_gaussians"
        if not self.named:
            pixels = self.training_pixels / 1e6
            how = f"from {self.area_m2:,.0f} m2 of street and {pixels:,.1f} million pixels"
        limit = f"limit of {self.most_gaussians:,} Gaussians ({how})"
        if not self.was_met:
            return f"{limit}: not met"
        parts = []
        if self.first_kept < self.first_found:
            parts.append(f"first points thinned from {self.first_found:,} to {self.first_kept:,}")
        if self.limited_from is not None:
            parts.append(f"{self.limited_changes} changes cut short from step {self.limited_from}")
        return f"{limit}: {', '.join(parts)}"


def gaussian_budget(config: SceneConfig, views: Sequence[TrainingView]) -> Budget:
    """The limit for a training on `views`; those held out do not count."""
    training = [view for view in views if not view.held_out]
    pixels = sum(view.camera.width * view.camera.height for view in training)
    area = street_area(np.array([view.world_from_camera[:2, 3] for view in training]))
    derived = max(INIT.least_limit, int(min(INIT.each_m2 * area, pixels / INIT.pixels_each)))
    return Budget(
        most_gaussians=config.max_gaussians or derived,
        named=config.max_gaussians is not None,
        area_m2=area,
        training_pixels=pixels,
    )


def street_area(positions: NDArray[np.float64]) -> float:
    """Square metres within `street_reach_m` of any position (N, 2), in cells of 5 m."""
    reach, cell = INIT.street_reach_m, INIT.street_cell_m
    steps = np.arange(-reach, reach + cell, cell)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    offsets = offsets[np.linalg.norm(offsets, axis=1) <= reach]
    near = np.unique(np.floor(positions / cell), axis=0) * cell
    cells = np.unique((near[:, None] + offsets).reshape(-1, 2), axis=0)
    return float(len(cells) * cell**2)
