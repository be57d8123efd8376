"""What befalls Gaussians between steps: density control, and even ground that lies as a sheet."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

import torch
from torch import Tensor

from recast.logs import GroundHeight, Track
from recast.scene.config import SceneConfig
from recast.scene.densify import DensityChange, GradientStatistics, plan_change
from recast.scene.trainable import TrainableScene, rows
from recast.splats import Gaussians, RowAdam, concatenate, morton_order
from recast.splats.gaussians import quat_multiply, quat_to_matrix

RESET_OPACITY = 0.01
"""What a reset leaves of an opacity (3DGS)."""
BOX_MARGIN_M = 0.15
"""How far an actor's centres may leave its box, to the sides and upwards."""
SETTLE_EVERY = 10
"""Steps: what a Gaussian drifts meanwhile is millimetres."""
REACH_M = 0.25
"""Gaussians farther above or below belong to something else."""
THICKNESS_M = 0.015
"""Most standard deviation across the sheet."""


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
    """Lower all opacities to `RESET_OPACITY`; what is needed grows back, what is not is pruned.

    Kerbl et al. 2023, section 5.2: against floaters close to the cameras. Moments are forgotten.
    """
    limit = math.log(RESET_OPACITY / (1 - RESET_OPACITY))
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
    high = half + BOX_MARGIN_M
    low = -high
    low[:, 2] = -half[:, 2] - 0.05
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
        return torch.nonzero(inside & (above < 2 * REACH_M))[:, 0]

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
        shortest way to its normal and is at most `THICKNESS_M`. Colours and opacities stay.
        """
        rows = self._perhaps_near(gaussians.means)
        height, normal = self.surface(gaussians.means[rows])
        above = gaussians.means[rows, 2] - height
        near = torch.nonzero(above.abs() < REACH_M)[:, 0]  # NaN is not near
        rows, height, normal = rows[near], height[near], normal[near]
        held = above[near].clamp(-self._tolerance, self._tolerance)
        gaussians.means[rows, 2] = height + held
        scales = gaussians.log_scales[rows]
        thinnest = scales.argmin(dim=1, keepdim=True)
        gaussians.quats[rows] = _upright(gaussians.quats[rows], thinnest[:, 0], normal)
        thin = scales.gather(1, thinnest).clamp(max=math.log(THICKNESS_M))
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
