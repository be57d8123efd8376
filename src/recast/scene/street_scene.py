"""A reconstructed street: what never moves, what does, and the sky."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray

from recast.logs import Trajectory
from recast.scene.appearance import Appearance, share_of
from recast.scene.dynamic import pose_at
from recast.scene.poses import corrected
from recast.scene.sky import SkyMap
from recast.splats import CLASSIC, Gaussians, LowPass, concatenate

Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]


@dataclass(frozen=True)
class SceneActor:
    """One moving object.

    Attributes:
        track_id: the track it stands for.
        gaussians: actor-local frame (box centre, x forward, y left, z up).
        size: (3,) length, width, height in metres.
        trajectory: refined `world_from_actor` as logged.
        shadow: actor-local Gaussians on the ground, drawn with the actor, or None.
        appearance: how the Gaussians' colours change over the trajectory's time, or None.
        low_pass: the filter that the Gaussians were made for, see `recast.splats.refiltered`.
    """

    track_id: str
    gaussians: Gaussians
    size: Array
    trajectory: Trajectory
    shadow: Gaussians | None = None
    appearance: Appearance | None = None
    low_pass: LowPass = CLASSIC

    def coloured_at(self, timestamp_us: int) -> SceneActor:
        """The actor with the colours that it had at a time of the recording."""
        if self.appearance is None:
            return self
        share = share_of(self.trajectory, timestamp_us)
        return replace(self, gaussians=self.appearance.at(self.gaussians, share), appearance=None)

    @property
    def drawn(self) -> Gaussians:
        """Gaussians and shadow together, actor-local."""
        return self.gaussians if self.shadow is None else concatenate([self.gaussians, self.shadow])


@dataclass(frozen=True)
class StreetScene:
    """Background, actors and sky.

    Attributes:
        background: world-frame Gaussians, all that stands still.
        actors: by track id.
        sky: colour at infinity.
        world_offset: (3,) float64, dataset coordinates = world coordinates + offset.
        camera_corrections: by camera name, times (F,) int64 and twists (F, 6) of the learned
            camera pose corrections (see `recast.scene.poses.corrected`).
        log_name: the log it was made from.
    """

    background: Gaussians
    actors: Mapping[str, SceneActor]
    sky: SkyMap
    world_offset: Array = field(default_factory=lambda: np.zeros(3))
    camera_corrections: Mapping[str, tuple[Int64Array, Array]] = field(default_factory=dict)
    log_name: str = ""

    def at(self, poses: Mapping[str, Array]) -> Gaussians:
        """Everything drawn when the actors stand at `poses`, in the world frame.

        Args:
            poses: `world_from_actor` (4, 4) by track id; actors not named are absent.

        Raises:
            KeyError: a pose for an actor that the scene does not have.
        """
        parts = [self.background]
        for track_id, pose in poses.items():
            parts.append(self.actors[track_id].drawn.transformed(torch.from_numpy(pose)))
        return concatenate(parts)

    def actor_poses(self, timestamp_us: int) -> dict[str, Array]:
        """Logged (refined) `world_from_actor` of the actors present at a time."""
        poses = {
            track_id: pose_at(actor.trajectory, timestamp_us)
            for track_id, actor in self.actors.items()
        }
        return {track_id: pose for track_id, pose in poses.items() if pose is not None}

    def with_actor(self, actor: SceneActor) -> StreetScene:
        """The scene with an actor added, or put in the place of the one with its track id."""
        return replace(self, actors={**self.actors, actor.track_id: actor})

    def corrected_camera(
        self, camera_from_world: Array, camera_name: str, timestamp_us: int
    ) -> Array:
        """A logged camera pose (4, 4) with the learned correction at its time."""
        return corrected(camera_from_world, self.camera_corrections, camera_name, timestamp_us)
