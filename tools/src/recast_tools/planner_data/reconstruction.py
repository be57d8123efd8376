"""A synthetic world as a run reconstructs it, with the log's target in three ways.

Log, street and vehicles are artefacts of a store: a dataset that was killed, and other datasets of
the same worlds, find them again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np
import torch
from rich.console import Console

from recast.actors import AUTO, DEFAULT_GENERATOR, DEFAULT_SEGMENTER, insert, load_actor
from recast.arrays import Array, Image
from recast.cameras import PinholeCamera
from recast.core import Artefact, Store
from recast.core.errors import InputError
from recast.geometry import se3
from recast.reconstruction import SceneConfig
from recast.runs.actor import ActorMakers
from recast.runs.arms import OWN_STREET
from recast.runs.making import (
    Maker,
    VehicleParts,
    drive_world,
    refine_vehicle,
    register_vehicle,
    train_street,
)
from recast.runs.run_folder import ACTOR_FOLDER, LOG_FOLDER
from recast.runs.sources import SourceLog, generator_source, segmenter_source
from recast.scene import StreetScene, load_scene
from recast.scene.street_scene import SceneRasterizer
from recast.synthetic import World
from recast.synthetic.write import Oracle
from recast_tools.planner_data.stage import SampleStage, stage_of
from recast_tools.planner_training.samples import RENDERERS, Renderer
from recast_tools.planner_training.task import HALF_VIEWS

_VARIANTS: tuple[Renderer, ...] = RENDERERS[1:]
_SEED = 0
_EVERY = 2
"""Every second of the moments of the log: five images a second and camera, about 2 m apart."""
_FAR_BELOW = 1000.0
"""Metres under the road, where a target is drawn that is not placed."""


class SamplePainter(Protocol):
    """Draws what a camera sees."""

    def __call__(
        self, name: str, camera: PinholeCamera, world_from_camera: Array, poses: Mapping[str, Array]
    ) -> Image:
        """(H, W, 3) uint8.

        Args:
            name: name of the rig's camera, which may be cropped here.
            world_from_camera: (4, 4), OpenCV camera frame.
            poses: `world_from_actor` (4, 4) of what moves, by track id; parked vehicles are always
                there.
        """


def traced(oracle: Oracle, rng: np.random.Generator) -> SamplePainter:
    """Draws the truth, each camera with the exposure it has in the log."""

    def paint(
        name: str, camera: PinholeCamera, world_from_camera: Array, poses: Mapping[str, Array]
    ) -> Image:
        brightness = oracle.world.exposure(name)
        drawn = oracle.render(camera, world_from_camera, poses, exposure=brightness, rng=rng)
        return drawn.rgb

    return paint


class Reconstruction:
    """A reconstructed world, ready to be drawn.

    Args:
        world: the truth.
        streets: the street with each variant of the target, by renderer.

    Attributes:
        stage: the world, with the target to be placed, and without those vehicles that move and
            that the street has no model of: they could be hit, but not seen.
    """

    def __init__(self, world: World, streets: Mapping[Renderer, StreetScene]) -> None:
        known = next(iter(streets.values())).actors
        there = {key: one for key, one in world.vehicles.items() if one.parked or key in known}
        self.stage: SampleStage = stage_of(replace(world, vehicles=there), (world.target,))
        self._rasterizers = {name: SceneRasterizer(one) for name, one in streets.items()}
        # A target that stands in the log would be drawn there unless it is placed.
        away = known[world.target].trajectory.poses[0].copy()
        away[2, 3] -= _FAR_BELOW
        self._unless_placed = {world.target: away}

    def painter(self, renderer: Renderer) -> SamplePainter:
        """Draws the street with a variant of the target."""
        rasterizer = self._rasterizers[renderer]

        def paint(
            name: str, camera: PinholeCamera, world_from_camera: Array, poses: Mapping[str, Array]
        ) -> Image:
            del name
            drawn = rasterizer.draw(
                camera, se3.inverse(world_from_camera), {**self._unless_placed, **poses}
            )
            return (drawn.rgb * 255).round().to(torch.uint8).cpu().numpy()

        return paint


def reconstruct(world: World, store: Store, steps: int) -> Reconstruction | None:
    """Reconstruct a world by the steps of a run, or find what was made of it.

    The log has images of the size at which samples are rendered, and all of them are trained on.

    Args:
        steps: number of steps of the street's training.

    Returns:
        None if the log shows too little of its target for a vehicle to be made.

    Raises:
        InputError: embreex is missing, or the disk refuses.
    """
    maker = Maker(store, Console(quiet=True))
    name = f"{world.name}-{world.seed}"
    size = HALF_VIEWS.width, HALF_VIEWS.height
    log = drive_world(maker, world, size, (), name, _EVERY)
    source = SourceLog.open(log.path / LOG_FOLDER)
    config = SceneConfig(
        scale=1.0, iterations=steps, holdout_every=0, threads=1, force_dynamic=(world.target,)
    )
    try:
        street = train_street(maker, source, config, OWN_STREET)
        parts = VehicleParts(
            DEFAULT_GENERATOR,
            generator_source(DEFAULT_GENERATOR),
            segmenter_source(DEFAULT_SEGMENTER),
            AUTO,
            1,
            lambda: ActorMakers.named(DEFAULT_GENERATOR, DEFAULT_SEGMENTER),
        )
        registered = register_vehicle(maker, source, world.target, parts, _SEED, config)
    except InputError as error:
        if error.where != source.log.name:  # it is not the log that is too poor
            raise
        return None
    refined = refine_vehicle(maker, registered, street, _SEED)
    scene = load_scene(street.path)
    streets = scene, _with(scene, registered), _with(scene, refined)
    return Reconstruction(world, dict(zip(_VARIANTS, streets, strict=True)))


def _with(scene: StreetScene, actor: Artefact) -> StreetScene:
    return insert(scene, load_actor(actor.path / ACTOR_FOLDER))
