"""What refinement minimises, what it moves, and its two descents.

First the whole vehicle: place, size, a smooth field of offsets, and the poses of its track. It is
symmetric to the plane between left and right: the side that was seen bends the other. Then every
Gaussian, as far as each may go."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
import torch.nn.functional as functional
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from recast.actors.actor import Actor
from recast.actors.icp import outer_surface, thinned
from recast.actors.refine.images import Layers
from recast.actors.refine.settings import REFINE, Steps
from recast.arrays import Array
from recast.reconstruction.losses import photometric_loss
from recast.reconstruction.settings import generator, picked_view
from recast.scene.actor import draw, mirrored
from recast.splats import Gaussians, LowPass, concatenate
from recast.splats.adam import RowAdam
from recast.splats.gaussians import C0, quat_multiply, quat_to_matrix
from recast.training.state import below

FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh")
Step = Callable[[], None]
_MIRRORS = 7  # stream of random numbers


class Bend:
    """p -> rotate_z(turn) (exp(grow) p + offsets(p)) + move, offsets from a coarse lattice.

    Args:
        size: (3,) size of the box, metres.

    Attributes:
        move: (3,) metres. turn: (1,) radians. grow: (3,) logarithms.
        offsets: (3, 4, 3, 6) metres at the lattice's nodes (up, across, along).
    """

    def __init__(self, size: Array) -> None:
        self._half = torch.from_numpy(np.asarray(size) * REFINE.lattice_room / 2).float()
        self.move = torch.zeros(3, requires_grad=True)
        self.turn = torch.zeros(1, requires_grad=True)
        self.grow = torch.zeros(3, requires_grad=True)
        self.offsets = torch.zeros(3, *REFINE.lattice[::-1], requires_grad=True)

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
        """How far the lattice bends: mean squares of offsets, of their steps and of the size."""
        steps = [(self.offsets.diff(dim=d) / REFINE.bend_step_m).square().mean() for d in (1, 2, 3)]
        sizes = (self.offsets / REFINE.bend_m).square().mean() + (
            self.grow / REFINE.grow_spread
        ).square().mean()
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
        count = max((last - first) // REFINE.knot_us + 1, 1) + 1
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
        """Mean squares of the offsets over `pose_spread`, and of their steps over half of it."""
        spread = torch.tensor(REFINE.pose_spread)
        steps = self.values.diff(dim=0) / (0.5 * spread)
        return (self.values / spread).square().mean() + steps.square().mean()


class FreeGaussians:
    """prior + freedom x change, field by field: Adam's steps shrink with the freedom.

    Args:
        prior: Gaussians in the actor frame; harmonics of any degree become at least those of degree
            1.
        freedom: (M,) in [0, 1] of the first M of them; the others stay.
        drawn: how many of the first no image can do without; all if None.

    Attributes:
        changes: leaf tensors by field, of the first M.
    """

    def __init__(self, prior: Gaussians, freedom: Tensor, drawn: int | None = None) -> None:
        if prior.sh.shape[1] < 4:
            room = (0, 0, 0, 4 - prior.sh.shape[1])
            prior = replace(prior, sh=torch.nn.functional.pad(prior.sh, room))
        self.prior, self._freedom = prior.detach(), freedom
        self._drawn = len(prior) if drawn is None else drawn
        self.changes = {
            name: torch.zeros_like(getattr(self.prior, name)[: len(freedom)], requires_grad=True)
            for name in FIELDS
        }

    def _change(self, name: str) -> Tensor:
        change = self.changes[name]
        return self._freedom.view(-1, *[1] * (change.ndim - 1)) * change

    def __call__(self) -> Gaussians:
        """Those that are drawn, as they stand; differentiable in the changes."""
        count, value = len(self._freedom), {}
        for name in FIELDS:
            prior = getattr(self.prior, name)
            changed = prior[:count] + self._change(name)
            if name == "log_scales":
                changed = changed.clamp(*REFINE.log_size)
            value[name] = torch.cat([changed, prior[count : self._drawn]])
        return Gaussians(**value)

    def whole(self, drawn: Gaussians) -> Gaussians:
        """Those that are drawn, and the others as they were."""
        return concatenate([drawn, self.prior.select(torch.arange(self._drawn, len(self.prior)))])

    def strain(self) -> Tensor:
        """Pull towards the prior: squares of shifts, of scales, of degree one."""
        moved = (self._change("means") / REFINE.shift_m).square().mean()
        grown = self._change("log_scales").square().mean()
        turned = self._change("sh")[:, 1:].square().mean()
        share = len(self._freedom) / len(self.prior)
        return share * (
            REFINE.shift_weight * moved
            + REFINE.scale_weight * grown
            + REFINE.direction_weight * turned
        )


class FreeShadow:
    """A level sheet whose opacities and colours follow the images.

    Args:
        prior: the sheet at first, actor frame.

    Attributes:
        changes: leaf tensors by field.
    """

    def __init__(self, prior: Gaussians) -> None:
        # A black Gaussian has no derivative by its colour.
        self._prior = replace(prior, sh=torch.full_like(prior.sh, (REFINE.dark - 0.5) / C0))
        self.changes = {
            name: torch.zeros_like(getattr(prior, name), requires_grad=True)
            for name in ("logit_opacities", "sh")
        }

    def __call__(self) -> Gaussians:
        """The sheet as it stands; differentiable in the changes."""
        moved = {name: getattr(self._prior, name) + self.changes[name] for name in self.changes}
        moved["logit_opacities"] = moved["logit_opacities"].clamp(max=REFINE.densest)
        return replace(self._prior, **moved)

    def strain(self) -> Tensor:
        """Pull towards the prior."""
        squares = [change.square().sum() for change in self.changes.values()]
        return REFINE.shade_weight * torch.stack(squares).sum() / max(len(self._prior), 1)


def split_rows(gaussians: Gaussians, chosen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Rows that stay whole, and twice those that are to be cut: chosen (N,) bool and not fine."""
    cut = chosen & (gaussians.log_scales.amax(dim=1) > math.log(REFINE.finest_m))
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
        step = REFINE.apart * cut.log_scales.amax(dim=1, keepdim=True).exp() * axis
        shorter = torch.full_like(cut.log_scales[:, :1], math.log(REFINE.shorter))
        parts.append(
            replace(
                cut,
                means=cut.means + way * step,
                log_scales=cut.log_scales.scatter_add(1, longest, shorter),
            )
        )
    return concatenate(parts)


@dataclass(frozen=True)
class ViewLoss:
    """Terms of one image, each a mean over the pixels that it compares."""

    colour: Tensor  # 0.8 |x - y| + 0.2 (1 - SSIM) on the vehicle
    outline: Tensor  # |opacity - mask|, weighted by trust, over the vehicle's pixels

    @property
    def total(self) -> Tensor:
        """The weighted sum."""
        return self.colour + REFINE.outline_weight * self.outline


def view_loss(
    gaussians: Gaussians,
    low_pass: LowPass,
    layers: Layers,
    offset: Tensor | None = None,
    shadow: Gaussians | None = None,
) -> ViewLoss:
    """Compare a vehicle and its shadow with one image; differentiable in all but the layers.

    Args:
        gaussians: Gaussians in the actor frame.
        low_pass: the filter that they are drawn through.
        offset: (4, 4) correction of the vehicle's pose, in its own frame.
        shadow: sheet on the ground, actor frame; that of the layers if None.
    """
    pose = layers.camera_from_world @ layers.world_from_object
    if offset is not None:
        pose = pose @ offset
    drawn = draw(gaussians, pose, layers.sighting.camera, low_pass)
    back = None
    if shadow is not None and len(shadow) > 0:
        cast = draw(shadow, pose, layers.sighting.camera)
        back = cast.rgb + (1 - cast.alpha)[..., None] * layers.street
    compared, road = layers.compared[..., None], layers.road[..., None]
    # Beside the vehicle only its shadow follows, so that it does not explain the road itself.
    beside = layers.around(drawn.rgb.detach(), drawn.alpha.detach(), back)
    shown = compared * layers.around(drawn.rgb, drawn.alpha, back) + road * beside
    shown = shown + (1 - compared - road) * layers.target
    area = layers.compared.sum().clamp(min=1.0) / layers.compared.numel()
    wanted = layers.mask * layers.through
    missed = (drawn.alpha * layers.through - wanted).abs() * layers.outlined
    return ViewLoss(
        photometric_loss(shown, layers.target, REFINE.ssim_weight) / area,
        missed.sum() / layers.compared.sum().clamp(min=1.0),
    )


@dataclass(frozen=True)
class RefinementTask:
    """What both descents have in common."""

    views: Sequence[Layers]  # images to follow
    held: Sequence[Layers]  # images that judge
    low_pass: LowPass  # the filter of the Gaussians
    symmetric: bool  # whether images teach the other side, too
    seed: int  # seed of the order of images and of the mirrored steps
    steps: Steps  # numbers of steps

    def image_loss(
        self,
        gaussians: Gaussians,
        poses: PoseOffsets,
        step: int,
        seen: Tensor | None = None,
        shadow: Gaussians | None = None,
    ) -> Tensor:
        """Weighted loss of the image of a step, now and then of the mirrored vehicle.

        Args:
            seen: (N,) in [0, 1], by how much the mirrored vehicle does not teach each Gaussian.
            shadow: see `view_loss`; the mirrored vehicle does not teach it.
        """
        view = self.views[picked_view(self.seed, step, len(self.views))]
        weight = view.sighting.weight
        chance = torch.rand((), generator=generator(self.seed, step, _MIRRORS))
        if self.symmetric and float(chance) < REFINE.mirror_chance:
            if seen is not None:
                gaussians = _held(gaussians, seen)
            gaussians = mirrored(gaussians, torch.ones(len(gaussians), dtype=torch.bool))
            weight *= REFINE.mirror_weight
            view = replace(view, outlined=view.trust)  # its edges are not those of this side
            shadow = None if shadow is None else shadow.detach()
        offset = poses.at(view.sighting.timestamp_us)
        return weight * view_loss(gaussians, self.low_pass, view, offset, shadow).total

    def judged(
        self, gaussians: Gaussians, poses: PoseOffsets | None, shadow: Gaussians | None = None
    ) -> float:
        """Mean loss on the held-back images, each weighted as its sighting; nan without one."""
        total = weight = 0.0
        with torch.no_grad():
            for view in self.held:
                sighting = view.sighting
                offset = None if poses is None else poses.at(sighting.timestamp_us)
                loss = view_loss(gaussians, self.low_pass, view, offset, shadow).total
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
    lidar = torch.from_numpy(thinned(hits, REFINE.lidar_points))
    nearest = torch.zeros(0, dtype=torch.int64)
    parameters = {**bend.parameters(), "poses": poses.values}
    adams = AdamDescent(parameters, REFINE.shape_rates())
    for index in range(task.steps.shape):
        loss = task.image_loss(bend(prior), poses, index)
        if len(lidar):
            placed = bend.points(points)
            if index % REFINE.nearest_every == 0:
                _, found = cKDTree(placed.detach().numpy()).query(lidar.numpy())
                nearest = torch.from_numpy(found)
            gap = ((lidar - placed[nearest]) * normals[nearest]).sum(-1)
            loss = (
                loss
                + REFINE.lidar_weight * torch.log1p((gap / REFINE.lidar_noise_m).square()).mean()
            )
        loss = loss + REFINE.strain_weight * (bend.strain() + poses.roughness())
        adams.descend(loss, index / task.steps.shape, parameters)
        step()


class FreeDescent:
    """The descent of every Gaussian, which may be left and taken up again.

    Args:
        free: Gaussians that the descent changes.
        shadow: their shadow, which it changes, too.
        poses: pose corrections of the track, which the descent goes on with.
        seen: (N,) in [0, 1], how much of each that is drawn images of its own side show: those of
            the other side leave it as it is.

    Attributes:
        index: number of steps done.
        best, best_shadow, best_loss: Gaussians and shadow with the least loss on the held-back
            images, and that loss.
    """

    def __init__(
        self,
        task: RefinementTask,
        free: FreeGaussians,
        shadow: FreeShadow,
        poses: PoseOffsets,
        seen: Tensor,
    ) -> None:
        self.task, self.free, self.shadow = task, free, shadow
        self.poses, self._seen = poses, seen
        self._parameters = {**free.changes, "poses": poses.values}
        self._parameters |= {f"shadow_{name}": one for name, one in shadow.changes.items()}
        self._adams = AdamDescent(self._parameters, REFINE.free_rates())
        self.index, self._worse = 0, 0
        self.best, self.best_shadow, self.best_loss = free().detach(), shadow().detach(), math.inf

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
        now, shadow = self.free(), self.shadow()
        loss = self.task.image_loss(now, self.poses, self.index, self._seen, shadow)
        loss = loss + self.free.strain() + self.shadow.strain()
        loss = loss + REFINE.strain_weight * self.poses.roughness()
        moved = {"sh", "shadow_sh", "shadow_logit_opacities"}
        moved = moved if self.index < self.task.steps.paint else set(self._parameters)
        self._adams.descend(loss, self.index / self.steps, moved)
        self.index += 1
        if self.index % self.task.steps.look_every == 0 or self.index == self.steps:
            self._look()

    def _look(self) -> None:
        now, shadow = self.free().detach(), self.shadow().detach()
        loss = self.task.judged(now, self.poses, shadow)
        if not self.task.held or loss < self.best_loss:
            self.best, self.best_shadow, self.best_loss, self._worse = now, shadow, loss, 0
        else:
            self._worse += 1

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Tensors and numbers from which `load` goes on."""
        tensors = {f"value.{name}": value for name, value in self._parameters.items()}
        tensors |= {f"adam.{name}": value for name, value in self._adams.state_dict().items()}
        for kind, best in (("best", self.best), ("best_shadow", self.best_shadow)):
            tensors |= {f"{kind}.{name}": getattr(best, name) for name in FIELDS}
        return tensors, {"index": self.index, "worse": self._worse, "loss": self.best_loss}

    def load(self, tensors: dict[str, Tensor], numbers: dict[str, Any]) -> None:
        """Go on from a state."""
        with torch.no_grad():
            for name, value in self._parameters.items():
                value.copy_(tensors[f"value.{name}"])
        self._adams.load_state_dict(below(tensors, "adam."))
        self.index, self._worse = int(numbers["index"]), int(numbers["worse"])
        self.best_loss = float(numbers["loss"])
        self.best, self.best_shadow = (
            Gaussians(**{name: tensors[f"{kind}.{name}"] for name in FIELDS})
            for kind in ("best", "best_shadow")
        )


def _held(gaussians: Gaussians, share: Tensor) -> Gaussians:
    """The same Gaussians, whose derivatives are less by a share (N,)."""

    def held(value: Tensor) -> Tensor:
        rows = share.view(-1, *[1] * (value.ndim - 1))
        return rows * value.detach() + (1 - rows) * value

    return Gaussians(**{name: held(getattr(gaussians, name)) for name in FIELDS})


class AdamDescent:
    """Adam of several tensors, whose rates fall together.

    Args:
        parameters: leaf tensors by name.
        rates: their learning rates at first.
    """

    def __init__(self, parameters: dict[str, Tensor], rates: dict[str, float]) -> None:
        self._adams = {
            name: RowAdam({name: value}, {name: rates[name]}) for name, value in parameters.items()
        }

    def descend(self, loss: Tensor, share: float, moved: Iterable[str]) -> None:
        """One step of the parameters `moved`, with rates that have fallen by `share` of the way."""
        for name, adam in self._adams.items():
            adam.params[name].grad = None
        loss.backward()
        fallen = REFINE.rate_fall**share
        for name, adam in self._adams.items():
            rate = fallen * adam.lrs[name] if name in moved else 0.0
            rows = torch.ones(len(adam.params[name]), dtype=torch.bool)
            adam.step(rows, {name: rate})

    def state_dict(self) -> dict[str, Tensor]:
        """Everything needed to go on but the parameters, as plain tensors."""
        return {
            f"{name}.{key}": value
            for name, adam in self._adams.items()
            for key, value in adam.state_dict().items()
        }

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Go on from `state_dict`."""
        for name, adam in self._adams.items():
            adam.load_state_dict(below(state, f"{name}."))
