"""One optimisation step of a scene, and all state that must survive a kill."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from recast.logs import DrivingLog, Track
from recast.scene.appearance import Exposures, exposed_scene, frozen, share_of
from recast.scene.bodies import Body
from recast.scene.config import SceneConfig
from recast.scene.deformation import DeformableNodes
from recast.scene.density_control import SETTLE_EVERY, GroundSheet, control_density, reset_opacities
from recast.scene.dynamic import DEFORMABLE, visible_rectangle
from recast.scene.initialise import Initialisation
from recast.scene.levels import Level, make_levels
from recast.scene.losses import (
    SHARP_SHAPE_EVERY,
    TrackSmoothness,
    actors_alone,
    sharp_shape,
    view_loss,
)
from recast.scene.poses import AdamTable, CameraPoses, TrackPoses
from recast.scene.schedule import (
    FLIPS,
    DensitySchedule,
    coarse_factor,
    exposure_rate,
    gaussian_rates,
    generator,
    picked_view,
    pose_factor,
    sky_rate,
)
from recast.scene.street_scene import Deforming, SceneActor, StreetScene
from recast.scene.trainable import DrawnView, TrainableScene, copy, make_sky
from recast.scene.views import TrainingView
from recast.splats import Gaussians, rasterize

RADIANS_PER_METRE = 0.1
"""Learning rate of a camera's rotation in radians to that of its translation in metres."""

REST_FROM = 3000
"""Steps that canonical centres of deformable actors learn for, as in OmniRe, however short a run:
they are where the LiDAR put them at first."""
DEFORMING_ROOM = 1.5
"""Factor of a deformable actor's box, outside of whose projection nothing of it is seen."""


@dataclass(frozen=True)
class StepReport:
    """Loss and PSNR (dB) of the view of one step."""

    loss: float
    psnr: float


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
        self._tracks = dict(tracks)
        self._density = DensitySchedule(config, len(self._views))
        self._levels = make_levels(config, self._views, start)
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
        self._smoothness = TrackSmoothness(self.track_poses)
        self.exposures = Exposures(self._views)
        self._sheet: GroundSheet | None = None
        if start.ground is not None:
            self._sheet = GroundSheet(start.ground, config.ground_tolerance_m, self.device)
            self._sheet.settle(self.model.background)
        self.sky = make_sky(config, start.sky)
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
        settles = self.iteration % SETTLE_EVERY == 0 or self.iteration == config.iterations
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
            size = DEFORMING_ROOM * self._tracks[name].size
            if name in self.deformable:
                seen = visible_rectangle(size, pose.detach().double().numpy(), view)
                found += [] if seen is None else [name]
        return found

    def _shaped(self, track_id: str, timestamp_us: int, gaussians: Gaussians) -> Gaussians:
        """Deformed; canonical centres rest from `REST_FROM` on, as in OmniRe. A body's do not."""
        trajectory = self._tracks[track_id].trajectory
        if track_id in self._bodies:
            return self._bodies[track_id].skinning.at(gaussians, trajectory, timestamp_us)
        if self.iteration >= REST_FROM:
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
        config, camera = self.config, level.camera
        poses = self.poses(view.timestamp_us)
        drawn = self._draw(poses, view, u)
        pose = self.camera_poses.camera_from_world(view)
        result = rasterize(
            drawn.gaussians,
            pose,
            level.K,
            camera.width,
            camera.height,
            absgrad=self._density.counts_sizes(self.iteration),
        )
        # The sky is smooth and far: the logged pose does for it.
        image = self.sky.behind(result.rgb, result.alpha, camera, view.camera_from_world)
        prior = image.new_zeros(())
        if self._exposes():
            image, change = self.exposures.applied(image, view)
            prior = config.exposure_weight * change
        if level.usable is not None:
            image = image * level.usable
        loss = view_loss(config, image, result, level)
        if config.sharp_shape_weight > 0 and self.iteration % SHARP_SHAPE_EVERY == 0:
            prior = prior + config.sharp_shape_weight * sharp_shape(drawn.gaussians.log_scales)
        if config.track_smoothness_weight > 0:
            rough = self._smoothness.loss().to(prior.device)
            prior = prior + config.track_smoothness_weight * rough
        if config.actor_opacity_weight > 0 and not self._density.goes_on(self.iteration):
            placed = [(self._tracks[name].size, at) for name, at in poses.items()]
            prior = prior + config.actor_opacity_weight * actors_alone(drawn, pose, level, placed)
        loss = loss + prior
        loss.backward()
        self.model.take_gradients(drawn)
        if self._density.counts(self.iteration):
            measures = config.densify_by, config.actor_densify_by
            self.model.count(drawn, result.meta, camera.width, camera.height, *measures)
        self._update(*self.model.visible(drawn, result.meta), u)
        squared = float((image.detach() - level.target).square().mean())
        return StepReport(float(loss.detach()), -10 * float(np.log10(max(squared, 1e-10))))

    def _update(self, background: Tensor, local: Tensor, u: float) -> None:
        config = self.config
        self.model.step(background, local, gaussian_rates(config, u))
        self.sky.table.step(sky_rate(config, u))
        with torch.no_grad():
            self.sky.table.value.clamp_(0, 1)
        self.exposures.table.step(exposure_rate(config, u))
        self.deformable.step(u)
        factor = pose_factor(u)
        self.track_poses.table.step(factor * config.actor_pose_lr)
        metres = factor * config.camera_pose_lr
        radians = RADIANS_PER_METRE * metres
        self.camera_poses.table.step(torch.tensor([metres] * 3 + [radians] * 3))

    def scene(self, log: DrivingLog) -> StreetScene:
        """The scene as it stands, copied to the CPU; colours are those of the mean exposure."""
        shapes = self.deformable.learned() | {k: v.skinning for k, v in self._bodies.items()}
        scene = StreetScene(
            background=copy(self.model.background).to("cpu"),
            actors={name: self._actor(name, shapes.get(name)) for name in self.model.track_ids},
            sky=self.sky.sky_map(),
            world_offset=log.world_offset,
            camera_corrections=self.camera_poses.corrections(self._views),
            log_name=log.name,
        )
        return exposed_scene(scene, self.exposures.mean()) if self._exposes() else scene

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
        )
