"""Density control applied to a scene under training: background in the world, actors in boxes."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

import torch
from torch import Tensor

from recast.logs import Track
from recast.scene.config import SceneConfig
from recast.scene.densify import Change, GradientStatistics, plan_change
from recast.scene.trainable import TrainableScene, rows
from recast.splats import Gaussians, RowAdam, concatenate, morton_order

RESET_OPACITY = 0.01
"""What a reset leaves of an opacity (3DGS)."""
BOX_MARGIN_M = 0.15
"""How far an actor's centres may leave its box, to the sides and upwards."""


def change_population(
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
    waves = model.waves[origin][by_owner]
    model.place(new_background.select(order), new_local.select(by_owner), owner[by_owner], waves)
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


def _merge(old: Gaussians, change: Change) -> Gaussians:
    return concatenate([old.detach().select(change.kept), change.born])


def _follow(adam: RowAdam, change: Change, order: Tensor, parameters: dict[str, Tensor]) -> None:
    """Carry the moments of the kept rows along; new rows start without history."""
    adam.select(change.kept)
    adam.append(len(change.born))
    adam.select(order)
    adam.params = parameters
