"""One optimisation step of a scene, and all state that must survive a kill."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from recast.arrays import Array
from recast.geometry import se3
from recast.logs import DrivingLog, Track
from recast.reconstruction.bodies import Body
from recast.reconstruction.config import Measure, SceneConfig
from recast.reconstruction.covered import without_leftovers
from recast.reconstruction.densify import (
    FIELDS,
    GradientStatistics,
    GroundSheet,
    control_density,
    reset_opacities,
    rows,
)
from recast.reconstruction.first_points import OPAQUE_LOGIT, Initialisation, sky_cells
from recast.reconstruction.losses import LOSS_TERMS, Drawing, DrawnView, Span, total_loss
from recast.reconstruction.settings import (
    FLIPS,
    OPTIM,
    DensitySchedule,
    coarse_factor,
    gaussian_rates,
    generator,
    picked_view,
    pose_factor,
)
from recast.reconstruction.tables import (
    AdamTable,
    CameraPoses,
    DeformableNodes,
    Exposures,
    TrackPoses,
    make_sky,
)
from recast.reconstruction.views import Level, TrainingView, make_levels, visible_rectangle
from recast.scene.actor import Deforming, SceneActor, coloured, frozen, mirrored, share_of
from recast.scene.store import save_scene
from recast.scene.street_scene import DEFORMABLE, StreetScene, twist_matrix
from recast.splats import Gaussians, RasterMeta, RowAdam, concatenate, rasterize

Shape = Callable[[Gaussians], Gaussians]
STATES = ("background_adam", "local_adam", "background_statistics", "local_statistics")
"""Members of `TrainableScene` that a checkpoint holds beside the parameters."""


@dataclass(frozen=True)
class StepReport:
    """What came of one step.

    Attributes:
        loss, psnr: loss and PSNR (dB) of its view.
        terms: weighted terms of the loss by name, scalars.
    """

    loss: float
    psnr: float
    terms: Mapping[str, Tensor]


class Trainer:
    """Holds everything that training changes.

    Attributes:
        iteration: number of steps done.
        device: device that holds the Gaussians, the sky and the view at hand; poses stay on the
            CPU.
        model: the Gaussians.
        deformable: the network that deforms actors.
        camera_poses, track_poses: pose corrections.
        exposures, sky: changes of the images' colours; the sky's colours.
        limited_from: step of the first change that `max_gaussians` cut short; None before.
        limited_changes: number of changes that `max_gaussians` cut short.
    """

    def __init__(
        self,
        config: SceneConfig,
        views: Sequence[TrainingView],
        tracks: Mapping[str, Track],
        start: Initialisation,
        device: torch.device | str = "cpu",
        bodies: Mapping[str, Body] | None = None,
    ) -> None:
        self.config = config
        self.iteration = 0
        self.device = torch.device(device)
        self._views = [view for view in views if not view.held_out]
        self._finished: tuple[int, StreetScene] | None = None
        self._tracks = dict(tracks)
        self._terms = [term(config) for term in LOSS_TERMS]
        self._density = DensitySchedule(config, len(self._views))
        self._levels = make_levels(config, self._views, start.sky_pixels, start.depths)
        self.model = TrainableScene(
            start.background.to(self.device),
            {name: part.to(self.device) for name, part in start.actors.items()},
            config.fourier_terms,
        )
        self._bodies = dict(bodies or {})
        free = {name: track for name, track in tracks.items() if name not in self._bodies}
        self.deformable = DeformableNodes(config, free, self.device)
        symmetric = [
            tracks[name].category not in DEFORMABLE
            and not (name in self.deformable or name in self._bodies)
            for name in self.model.track_ids
        ]
        self._symmetric = torch.tensor(symmetric, dtype=torch.bool)
        self.camera_poses = CameraPoses(self._views)
        self.track_poses = TrackPoses(tracks, views)
        self.exposures = Exposures(self._views, config.exposure_s)
        self._sheet: GroundSheet | None = None
        if start.ground is not None:
            self._sheet = GroundSheet(start.ground, config.ground_tolerance_m, self.device)
            self._sheet.settle(self.model.background)
        self.sky = make_sky(config, start.sky)
        self._sky_seen = sky_cells(self._views, start.sky_pixels, self.sky.sky_map())
        self.sky.table.to(self.device)
        self.limited_from: int | None = None
        self.limited_changes = 0

    def step(self) -> StepReport:
        """Fit one view, then densify when it is time."""
        config = self.config
        u = self.iteration / config.iterations
        index = picked_view(config.seed, self.iteration, len(self._views))
        level = self._levels[coarse_factor(config, u)][index].unpacked(self.device)
        report = self._fit(self._views[index], level, u)
        self.iteration += 1
        if self._density.changes(self.iteration):
            oversize = self._density.prunes_oversize(self.iteration)
            rng = generator(config.seed, self.iteration)
            bodies = self._bodies.keys()
            if control_density(self.model, self._tracks, config, rng, oversize, bodies):
                self.limited_changes += 1
                self.limited_from = self.limited_from or self.iteration
        if self._density.resets(self.iteration):
            reset_opacities(self.model)
        settles = self.iteration % OPTIM.settle_every == 0 or self.iteration == config.iterations
        if self._sheet is not None and settles:
            self._sheet.settle(self.model.background)
        return report

    def tables(self) -> dict[str, AdamTable]:
        """What is learned beside the Gaussians, by name."""
        found = {
            "sky": self.sky.table,
            "camera_poses": self.camera_poses.table,
            "track_poses": self.track_poses.table,
            **self.deformable.tables(),
        }
        return {**found, "exposures": self.exposures.table} if self._exposes() else found

    def _exposes(self) -> bool:
        return self.config.exposure_lr > 0

    def poses(self, timestamp_us: int) -> dict[str, Tensor]:
        """`world_from_actor` (4, 4) of the actors present, differentiable in their offsets."""
        found = self.track_poses.world_from_actors(timestamp_us)
        return {name: found[name] for name in self.model.track_ids if name in found}

    def _draw(self, poses: Mapping[str, Tensor], view: TrainingView, u: float) -> DrawnView:
        time = view.timestamp_us
        shares = {name: share_of(self._tracks[name].trajectory, time) for name in poses}
        shapes = {
            name: partial(self._shaped, name, time) for name in self._deformed(poses, view, u)
        }
        return self.model.draw(poses, shares, self._flipped(), shapes)

    def _deformed(self, poses: Mapping[str, Tensor], view: TrainingView, u: float) -> list[str]:
        """Actors to deform: bodies, and others whose box, with some room, is in the image."""
        found = [name for name in poses if name in self._bodies]
        if not self.deformable.begun(u):
            return found
        for name, pose in poses.items():
            size = OPTIM.deforming_room * self._tracks[name].size
            if name in self.deformable:
                seen = visible_rectangle(size, pose.detach().double().numpy(), view)
                found += [] if seen is None else [name]
        return found

    def _shaped(self, track_id: str, timestamp_us: int, gaussians: Gaussians) -> Gaussians:
        """Deformed; canonical centres rest from `rest_from` on, as in OmniRe. A body's do not."""
        trajectory = self._tracks[track_id].trajectory
        if track_id in self._bodies:
            return self._bodies[track_id].skinning.at(gaussians, trajectory, timestamp_us)
        if self.iteration >= OPTIM.rest_from:
            gaussians = replace(gaussians, means=gaussians.means.detach())
        return self.deformable.deformation(track_id).at(gaussians, trajectory, timestamp_us)

    def _flipped(self) -> Tensor | None:
        """Rows of actors that this step sees mirrored, drawn anew for every step."""
        probability = self.config.flip_probability
        if probability == 0:
            return None
        owner = self.model.owner
        rng = generator(self.config.seed, self.iteration, FLIPS)
        drawn = torch.rand(len(owner), generator=rng) < probability
        return (drawn & self._symmetric[owner]).to(self.device)

    def _fit(self, view: TrainingView, level: Level, u: float) -> StepReport:
        """Draw, compare, and move what was drawn."""
        config, camera = self.config, level.camera
        poses = self.poses(view.timestamp_us)
        drawn = self._draw(poses, view, u)
        pose = self.camera_poses.camera_from_world(view)
        size = camera.width, camera.height
        absolute = self._density.counts_sizes(self.iteration)
        result = rasterize(
            drawn.gaussians,
            pose,
            level.K,
            *size,
            eps2d=config.low_pass.variance,
            antialiased=config.low_pass.antialiased,
            absgrad=absolute,
        )
        # The sky is smooth and far: the logged pose does for it.
        image = self.sky.behind(result.rgb, result.alpha, camera, view.camera_from_world)
        change = None
        if self._exposes():
            image, change = self.exposures.applied(image, view)
        if level.usable is not None:
            image = image * level.usable
        drawing = Drawing(
            iteration=self.iteration,
            grows=self._density.goes_on(self.iteration),
            image=image,
            result=result,
            drawn=drawn,
            camera_from_world=pose,
            boxes=[(self._tracks[name].size, at) for name, at in poses.items()],
            exposure_change=change,
            tracks=self.track_poses,
        )
        loss, terms = total_loss(self._terms, drawing, level)
        loss.backward()
        self.model.take_gradients(drawn)
        if self._density.counts(self.iteration):
            measures = config.densify_by, config.actor_densify_by
            self.model.count(drawn, result.meta, *size, *measures)
        self._update(*self.model.visible(drawn, result.meta), u)
        squared = float((image.detach() - level.target).square().mean())
        psnr = -10 * float(np.log10(max(squared, 1e-10)))
        return StepReport(float(loss.detach()), psnr, terms)

    def _update(self, background: Tensor, local: Tensor, u: float) -> None:
        """Adam's step, of the rows that the view saw and of all tables."""
        config = self.config
        self.model.step(background, local, gaussian_rates(config, u))
        self.sky.table.step(config.sky_lr * OPTIM.sky_decay**u)
        with torch.no_grad():
            self.sky.table.value.clamp_(0, 1)
        self.exposures.table.step(config.exposure_lr * OPTIM.exposure_decay**u)
        self.deformable.step(u)
        factor = pose_factor(u)
        self.track_poses.table.step(factor * config.actor_pose_lr)
        metres = factor * config.camera_pose_lr
        radians = OPTIM.radians_per_metre * metres
        self.camera_poses.table.step(torch.tensor([metres] * 3 + [radians] * 3))

    def scene(self, log: DrivingLog) -> StreetScene:
        """The scene as it stands, copied to the CPU; its colours have the mean exposure."""
        unseen = ~self.model.background_adam.moved.to("cpu")
        background = copy(self.model.background).to("cpu")
        if self.config.unseen_surfaces:
            background = replace(
                background,
                logit_opacities=torch.where(unseen, OPAQUE_LOGIT, background.logit_opacities),
            )
        shapes = self.deformable.learned() | {k: v.skinning for k, v in self._bodies.items()}
        scene = StreetScene(
            background=background,
            actors={name: self._actor(name, shapes.get(name)) for name in self.model.track_ids},
            sky=self.sky.sky_map(),
            world_offset=log.world_offset,
            camera_corrections=self.camera_poses.corrections(self._views),
            log_name=log.name,
            low_pass=self.config.low_pass,
            mounts=self._mounts(log),
            unseen=unseen,
            sky_seen=self._sky_seen,
        )
        if not self._exposes():
            return scene
        scene = replace(scene, exposures=self.exposures.learned())
        return scene.exposed(self.exposures.mean())

    def _mounts(self, log: DrivingLog) -> dict[str, Array]:
        """What of the cameras' corrections is the same at all times, in the rig's frame."""
        found = {}
        for name, (_, twists) in self.camera_poses.corrections(self._views).items():
            moved = twist_matrix(torch.from_numpy(twists.mean(axis=0))).numpy()
            rig_from_camera = log.cameras[name].rig_from_camera
            found[name] = rig_from_camera @ se3.inverse(moved) @ se3.inverse(rig_from_camera)
        return found

    def finished(self, log: DrivingLog) -> StreetScene:
        """The scene at the end of training, see `without_leftovers`."""
        if self._finished is None or self._finished[0] != self.iteration:
            scene = self.scene(log)
            if self.config.unseen_surfaces:
                scene = without_leftovers(scene, log, self._views)
            self._finished = self.iteration, scene
        return self._finished[1]

    def save(self, log: DrivingLog, folder: Path) -> StreetScene:
        """Write the finished scene into a folder, see `save_scene`."""
        scene = self.finished(log)
        save_scene(scene, folder)
        return scene

    def _actor(self, track_id: str, deformation: Deforming | None) -> SceneActor:
        learned, fourier = self.model.actor(track_id)
        share = self.config.appearance_share
        gaussians, appearance = frozen(learned.to("cpu"), fourier.cpu(), share)
        return SceneActor(
            track_id=track_id,
            gaussians=gaussians,
            size=self._tracks[track_id].size,
            trajectory=self.track_poses.refined(track_id),
            appearance=appearance,
            deformation=deformation,
            low_pass=self.config.low_pass,
        )


class TrainableScene:
    """Background and actors with their optimiser states.

    Attributes:
        track_ids: the actors, in order.
        owner: (A,) int64, ascending, on the CPU: the actor of each row of `local`.
        background: world-frame parameters, views into the buffer.
        local: all actors' parameters, box frames, one after the other.
        fourier: (A, F - 1, 3) how the actors' colours change over their time, see
            `recast.scene.actor`; F is 1 where they do not.
    """

    background: Gaussians
    local: Gaussians
    owner: Tensor
    fourier: Tensor

    def __init__(
        self, background: Gaussians, actors: Mapping[str, Gaussians], fourier_terms: int = 1
    ) -> None:
        self.track_ids = tuple(actors)
        nothing = background.select(torch.zeros(0, dtype=torch.int64))
        counts = torch.tensor([len(part) for part in actors.values()], dtype=torch.int64)
        owner = torch.repeat_interleave(torch.arange(len(actors)), counts)
        local = concatenate([nothing, *actors.values()])
        fourier = local.means.new_zeros(len(local), fourier_terms - 1, 3)
        self.place(background, local, owner, fourier)
        device = self.background.means.device
        self.background_statistics = GradientStatistics(len(self.background), device)
        self.local_statistics = GradientStatistics(len(self.local), device)
        self.background_adam = _adam(self.background, rows(self.background), math.inf)
        self.local_adam = _adam(self.local, self.local_parameters(), OPTIM.max_actor_log_scale)

    def place(
        self, background: Gaussians, local: Gaussians, owner: Tensor, fourier: Tensor
    ) -> None:
        """Lay out new parameter values; optimiser states are the caller's business."""
        room = concatenate([background.detach(), local.detach()])
        self._buffer = Gaussians(**{name: value.contiguous() for name, value in rows(room).items()})
        n = len(background)
        self.background = Gaussians(**{k: v[:n] for k, v in rows(self._buffer).items()})
        self.local = Gaussians(
            **{k: v.clone().requires_grad_() for k, v in rows(local.detach()).items()}
        )
        self.fourier = fourier.detach().clone().requires_grad_()
        self.owner = owner

    def local_parameters(self) -> dict[str, Tensor]:
        """The actors' leaf tensors by name."""
        parameters = rows(self.local)
        return {**parameters, "waves": self.fourier} if self.fourier.shape[1] else parameters

    def span(self, track_id: str) -> tuple[int, int]:
        """Rows [start, stop) of an actor in `local`."""
        index = self.track_ids.index(track_id)
        start, stop = torch.searchsorted(self.owner, torch.tensor([index, index + 1])).tolist()
        return start, stop

    def draw(
        self,
        poses: Mapping[str, Tensor],
        shares: Mapping[str, float] | None = None,
        flipped: Tensor | None = None,
        shapes: Mapping[str, Shape] | None = None,
    ) -> DrawnView:
        """Put the actors at `world_from_actor` poses (4, 4) behind the background.

        Args:
            shares: shares of each actor's time, where colours change with it.
            flipped: (A,) bool, rows of actors to draw mirrored; see `recast.scene.actor`.
            shapes: what moves the Gaussians of an actor within its box, differentiable.
        """
        first = len(self.background)
        spans = []
        # One split a field: slices of their own would each bring a gradient of all rows.
        counts = torch.bincount(self.owner, minlength=len(self.track_ids)).tolist()
        ends = dict(zip(self.track_ids, np.cumsum(counts).tolist(), strict=True))
        fields = zip(*(value.split(counts) for value in rows(self.local).values()), strict=True)
        parts = {name: Gaussians(*own) for name, own in zip(self.track_ids, fields, strict=True)}
        for track_id, pose in poses.items():
            own = parts[track_id]
            start, stop = ends[track_id] - len(own), ends[track_id]
            if shares is not None and self.fourier.shape[1]:
                own = coloured(own, self.fourier[start:stop], shares[track_id])
            if flipped is not None:
                own = mirrored(own, flipped[start:stop])
            if shapes is not None and track_id in shapes:
                own = shapes[track_id](own)
            posed = own.transformed(pose)
            last = first + stop - start
            for name in FIELDS:
                getattr(self._buffer, name)[first:last] = getattr(posed, name).detach()
            spans.append(Span(first, last, start, stop, posed))
            first = last
        leaves = {k: v[:first].requires_grad_() for k, v in rows(self._buffer).items()}
        return DrawnView(Gaussians(**leaves), tuple(spans))

    def take_gradients(self, drawn: DrawnView) -> None:
        """After the loss's backward pass: carry it on to the parameters and the actors' poses."""
        gradients = {k: v.grad for k, v in rows(drawn.gaussians).items()}
        n = len(self.background)
        for name in FIELDS:
            gradient = gradients[name]
            getattr(self.background, name).grad = None if gradient is None else gradient[:n]
            getattr(self.local, name).grad = None
        self.fourier.grad = None
        outputs, given = [], []
        for name, gradient in gradients.items():
            if gradient is not None:
                outputs += [getattr(span.posed, name) for span in drawn.spans]
                given += [gradient[span.first : span.last] for span in drawn.spans]
        torch.autograd.backward(outputs, given)

    def visible(self, drawn: DrawnView, meta: RasterMeta) -> tuple[Tensor, Tensor]:
        """Which rows of the background and of the actors the view saw: two bool masks."""
        local = torch.zeros(len(self.local), dtype=torch.bool, device=meta.visible.device)
        for span in drawn.spans:
            local[span.start : span.stop] = meta.visible[span.first : span.last]
        return meta.visible[: len(self.background)], local

    def count(
        self,
        drawn: DrawnView,
        meta: RasterMeta,
        width: int,
        height: int,
        measure: Measure = "signed",
        actor_measure: Measure = "signed",
    ) -> None:
        """Add a view's screen-space gradients to the statistics for density control."""
        every = slice(0, len(self.background))
        self.background_statistics.add(meta, every, every, width, height, measure)
        for span in drawn.spans:
            source, target = slice(span.first, span.last), slice(span.start, span.stop)
            self.local_statistics.add(meta, source, target, width, height, actor_measure)

    def step(self, background: Tensor, local: Tensor, rates: Mapping[str, float]) -> None:
        """Adam on the visible rows, within the bounds that keep Gaussians honest.

        Args:
            background, local: visible rows, as `visible` gives.
            rates: learning rate by field; `sh` is that of the constant band, over time as well.
        """
        self.background_adam.step(background, rates)
        if len(self.local):
            self.local_adam.step(local, {**rates, "waves": rates["sh"]})

    def count_rows(self) -> int:
        """Number of Gaussians, actors included."""
        return len(self.background) + len(self.local)

    def restore(self, states: Mapping[str, Mapping[str, Tensor]]) -> None:
        """After `place`: take over the `STATES` of a checkpoint."""
        self.background_adam.params = rows(self.background)
        self.local_adam.params = self.local_parameters()
        for name in STATES:
            getattr(self, name).load_state_dict(states[name])

    def actor(self, track_id: str) -> tuple[Gaussians, Tensor]:
        """Copies of an actor's Gaussians in its box frame, and of their `fourier`."""
        part = slice(*self.span(track_id))
        return copy(self.local, part), self.fourier.detach()[part].clone()


def copy(gaussians: Gaussians, part: slice = slice(None)) -> Gaussians:
    """Rows of their own, without history."""
    return Gaussians(**{k: v.detach()[part].clone() for k, v in rows(gaussians).items()})


def _adam(gaussians: Gaussians, parameters: Mapping[str, Tensor], max_log_scale: float) -> RowAdam:
    bases = gaussians.sh.shape[1]
    rates = torch.full((bases, 3), OPTIM.rest_rate)
    rates[0] = 1
    limit = torch.full((bases, 3), math.inf)
    limit[0] = OPTIM.colour_limit
    return RowAdam(
        parameters,
        {},
        column_rates={"sh": rates},
        bounds={"sh": (-limit, limit), "log_scales": (OPTIM.min_log_scale, max_log_scale)},
    )
