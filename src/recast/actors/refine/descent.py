"""What refinement minimises, and its two descents: the whole body, then every Gaussian."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from recast.actors.actor import Actor
from recast.actors.icp import outer_surface, thinned
from recast.actors.refine.parameters import FIELDS, Bend, FreeGaussians, PoseOffsets
from recast.actors.refine.surroundings import Layers
from recast.reconstruction.losses import photometric_loss
from recast.reconstruction.schedule import generator, picked_view
from recast.scene.actor import draw
from recast.scene.appearance import mirrored
from recast.splats import Gaussians, LowPass

SSIM_WEIGHT = 0.2
OUTLINE_WEIGHT = 0.5
Step = Callable[[], None]

_MIRROR_CHANCE, _MIRROR_WEIGHT = 0.35, 0.5
_MIRRORS = 7  # stream of random numbers
_FALL = 0.1  # factor of all rates at the end of a descent
_STRAIN, _LIDAR = 0.002, 0.03  # weights
_LIDAR_POINTS, _LIDAR_NOISE, _NEAREST_EVERY = 1500, 0.04, 15
_SHAPE_RATES = {"move": 4e-3, "turn": 1e-3, "grow": 2e-3, "offsets": 2e-3}
_POSE_RATE = 1e-3
_FREE_RATES = {
    "means": 1e-3,
    "quats": 2e-3,
    "log_scales": 6e-3,
    "logit_opacities": 3e-2,
    "sh": 6e-3,
}


@dataclass(frozen=True)
class ViewLoss:
    """Terms of one image, each a mean over the pixels that it compares.

    Attributes:
        colour: 0.8 |x - y| + 0.2 (1 - SSIM) on the vehicle.
        outline: |opacity - mask|, weighted by trust, over the vehicle's pixels.
    """

    colour: Tensor
    outline: Tensor

    @property
    def total(self) -> Tensor:
        """The weighted sum."""
        return self.colour + OUTLINE_WEIGHT * self.outline


def view_loss(
    gaussians: Gaussians, low_pass: LowPass, layers: Layers, offset: Tensor | None = None
) -> ViewLoss:
    """Compare a vehicle with one image; differentiable in all but the layers.

    Args:
        gaussians: Gaussians in the actor frame.
        low_pass: the filter that they are drawn through.
        offset: (4, 4) correction of the vehicle's pose, in its own frame.
    """
    pose = layers.camera_from_world @ layers.world_from_object
    if offset is not None:
        pose = pose @ offset
    drawn = draw(gaussians, pose, layers.sighting.camera, low_pass)
    compared = layers.compared[..., None]
    shown = layers.around(drawn.rgb, drawn.alpha)
    # Beside the vehicle both are the target, so that nothing there is explained by the vehicle.
    shown = compared * shown + (1 - compared) * layers.target
    area = layers.compared.sum().clamp(min=1.0) / layers.compared.numel()
    wanted = layers.mask * layers.through
    missed = (drawn.alpha * layers.through - wanted).abs() * layers.trust
    return ViewLoss(
        photometric_loss(shown, layers.target, SSIM_WEIGHT) / area,
        missed.sum() / layers.compared.sum().clamp(min=1.0),
    )


@dataclass(frozen=True)
class Steps:
    """How long the descents are.

    Attributes:
        shape: steps of the whole body.
        paint: steps of the colours alone, with which the second descent begins.
        free: steps of every Gaussian after that, at most.
        look_every: steps between looks at the held-back images.
        patience: looks without a better loss after which the second descent ends.
    """

    shape: int = 120
    paint: int = 80
    free: int = 1200
    look_every: int = 50
    patience: int = 4


@dataclass(frozen=True)
class RefinementTask:
    """What both descents have in common.

    Attributes:
        views: images to follow.
        held: images that judge.
        low_pass: the filter of the Gaussians.
        symmetric: whether images teach the other side, too.
        seed: seed of the order of images and of the mirrored steps.
        steps: numbers of steps.
    """

    views: Sequence[Layers]
    held: Sequence[Layers]
    low_pass: LowPass
    symmetric: bool
    seed: int
    steps: Steps

    def image_loss(
        self, gaussians: Gaussians, poses: PoseOffsets, step: int, seen: Tensor | None = None
    ) -> Tensor:
        """Weighted loss of the image of a step, now and then of the mirrored vehicle.

        Args:
            seen: (N,) in [0, 1], by how much the mirrored vehicle does not teach each Gaussian.
        """
        view = self.views[picked_view(self.seed, step, len(self.views))]
        weight = view.sighting.weight
        chance = torch.rand((), generator=generator(self.seed, step, _MIRRORS))
        if self.symmetric and float(chance) < _MIRROR_CHANCE:
            if seen is not None:
                gaussians = _held(gaussians, seen)
            gaussians = mirrored(gaussians, torch.ones(len(gaussians), dtype=torch.bool))
            weight *= _MIRROR_WEIGHT
        offset = poses.at(view.sighting.timestamp_us)
        return weight * view_loss(gaussians, self.low_pass, view, offset).total

    def judged(self, gaussians: Gaussians, poses: PoseOffsets | None) -> float:
        """Mean loss on the held-back images, each weighted as its sighting; nan without one."""
        total = weight = 0.0
        with torch.no_grad():
            for view in self.held:
                sighting = view.sighting
                offset = None if poses is None else poses.at(sighting.timestamp_us)
                loss = view_loss(gaussians, self.low_pass, view, offset).total
                total += float(loss) * sighting.weight
                weight += sighting.weight
        return total / weight if weight else math.nan


def fit_shape(
    task: RefinementTask,
    actor: Actor,
    hits: np.ndarray[Any, np.dtype[np.float32]],
    bend: Bend,
    poses: PoseOffsets,
    step: Step,
) -> None:
    """Move and bend a body, and correct its track, in place.

    Args:
        hits: (N, 3) LiDAR points, object frame.
        step: called after every step.
    """
    prior = actor.gaussians.detach()
    surface = outer_surface(prior)
    points = torch.from_numpy(surface.points).float()
    normals = torch.from_numpy(surface.normals).float()
    lidar = torch.from_numpy(thinned(hits, _LIDAR_POINTS))
    nearest = torch.zeros(0, dtype=torch.int64)
    parameters = {**bend.parameters(), "poses": poses.values}
    optimiser = _adam(parameters, {**_SHAPE_RATES, "poses": _POSE_RATE})
    for index in range(task.steps.shape):
        loss = task.image_loss(bend(prior), poses, index)
        if len(lidar):
            placed = bend.points(points)
            if index % _NEAREST_EVERY == 0:
                _, found = cKDTree(placed.detach().numpy()).query(lidar.numpy())
                nearest = torch.from_numpy(found)
            gap = ((lidar - placed[nearest]) * normals[nearest]).sum(-1)
            loss = loss + _LIDAR * torch.log1p((gap / _LIDAR_NOISE).square()).mean()
        loss = loss + _STRAIN * (bend.strain() + poses.roughness())
        _descend(optimiser, loss, index / task.steps.shape, parameters)
        step()


class FreeDescent:
    """The descent of every Gaussian, which may be left and taken up again.

    Args:
        free: Gaussians that the descent changes.
        poses: pose corrections of the track, which the descent goes on with.
        seen: (N,) in [0, 1], how much of each Gaussian images of its own side show: those of the
            other side leave it as it is.

    Attributes:
        index: number of steps done.
        best, best_loss: the Gaussians with the least loss on the held-back images, and that loss.
    """

    def __init__(
        self, task: RefinementTask, free: FreeGaussians, poses: PoseOffsets, seen: Tensor
    ) -> None:
        self.task, self.free, self.poses, self._seen = task, free, poses, seen
        self._parameters = {**free.changes, "poses": poses.values}
        self._optimiser = _adam(self._parameters, {**_FREE_RATES, "poses": 0.3 * _POSE_RATE})
        self.index, self._worse = 0, 0
        self.best, self.best_loss = free().detach(), math.inf

    @property
    def steps(self) -> int:
        """Steps at most."""
        return self.task.steps.paint + self.task.steps.free

    @property
    def done(self) -> bool:
        """Whether it has come to its end."""
        return self.index >= self.steps or self._worse >= self.task.steps.patience

    def step(self) -> None:
        """One step: colours alone at first, then everything; a look now and then."""
        loss = self.task.image_loss(self.free(), self.poses, self.index, self._seen)
        loss = loss + self.free.strain() + _STRAIN * self.poses.roughness()
        moved = {"sh"} if self.index < self.task.steps.paint else set(self._parameters)
        _descend(self._optimiser, loss, self.index / self.steps, moved)
        self.index += 1
        if self.index % self.task.steps.look_every == 0 or self.index == self.steps:
            self._look()

    def _look(self) -> None:
        now = self.free().detach()
        loss = self.task.judged(now, self.poses)
        if not self.task.held or loss < self.best_loss:
            self.best, self.best_loss, self._worse = now, loss, 0
        else:
            self._worse += 1

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Tensors and numbers from which `load` goes on."""
        tensors = {f"value.{name}": value for name, value in self._parameters.items()}
        for group in self._optimiser.param_groups:
            kept = self._optimiser.state[group["params"][0]]
            tensors |= {f"{key}.{group['name']}": value for key, value in kept.items()}
        tensors |= {f"best.{name}": getattr(self.best, name) for name in self.free.changes}
        return tensors, {"index": self.index, "worse": self._worse, "loss": self.best_loss}

    def load(self, tensors: dict[str, Tensor], numbers: dict[str, Any]) -> None:
        """Go on from a state."""
        with torch.no_grad():
            for name, value in self._parameters.items():
                value.copy_(tensors[f"value.{name}"])
        for group in self._optimiser.param_groups:
            ending = f".{group['name']}"
            self._optimiser.state[group["params"][0]] = {
                key.removesuffix(ending): value
                for key, value in tensors.items()
                if key.endswith(ending) and not key.startswith(("value.", "best."))
            }
        self.index, self._worse = int(numbers["index"]), int(numbers["worse"])
        self.best_loss = float(numbers["loss"])
        self.best = Gaussians(**{name: tensors[f"best.{name}"] for name in self.free.changes})


def _held(gaussians: Gaussians, share: Tensor) -> Gaussians:
    """The same Gaussians, whose derivatives are less by a share (N,)."""

    def held(value: Tensor) -> Tensor:
        rows = share.view(-1, *[1] * (value.ndim - 1))
        return rows * value.detach() + (1 - rows) * value

    return Gaussians(**{name: held(getattr(gaussians, name)) for name in FIELDS})


def _adam(parameters: dict[str, Tensor], rates: dict[str, float]) -> torch.optim.Adam:
    groups = [
        {"params": [value], "lr": rates[name], "rate": rates[name], "name": name}
        for name, value in parameters.items()
    ]
    return torch.optim.Adam(groups, eps=1e-15)


def _descend(optimiser: torch.optim.Adam, loss: Tensor, share: float, moved: Iterable[str]) -> None:
    """One step of the parameters `moved`, with rates that have fallen by `share` of the way."""
    optimiser.zero_grad()
    loss.backward()
    for group in optimiser.param_groups:
        group["lr"] = group["rate"] * _FALL**share if group["name"] in moved else 0.0
    optimiser.step()
