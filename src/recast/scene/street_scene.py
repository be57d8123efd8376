"""A reconstructed street: what never moves, what does, and the sky."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from recast.arrays import Array, Int64Array
from recast.logs.checks import check_times
from recast.scene.actor import SceneActor, check_gaussians
from recast.scene.appearance import exposed, exposed_colours
from recast.scene.poses import corrected, pose_at, stands
from recast.scene.sky import SkyMap
from recast.splats import Gaussians, concatenate

MOST_CORRECTED = 100.0
"""Largest learned correction of a camera, metres or radians."""


class Insertable(Protocol):
    """What can take an actor's place in a scene, such as `recast.actors.Actor`."""

    def inserted_into(self, scene: StreetScene) -> StreetScene:
        """The scene with it in the place of the actor with its track id."""


@dataclass(frozen=True)
class StreetScene:
    """Background, actors and sky.

    Attributes:
        background: world-frame Gaussians, all that stands still.
        actors: actors by track id.
        sky: colour at infinity.
        world_offset: (3,) float64, dataset coordinates = world coordinates + offset.
        camera_corrections: learned camera pose corrections by camera name: times (F,) int64 and
            twists (F, 6) (see `recast.scene.poses.corrected`).
        log_name: the log it was made from.
        origin: the folder that it was read from; None for one that was changed or never saved.
    """

    background: Gaussians
    actors: Mapping[str, SceneActor]
    sky: SkyMap
    world_offset: Array = field(default_factory=lambda: np.zeros(3))
    camera_corrections: Mapping[str, tuple[Int64Array, Array]] = field(default_factory=dict)
    log_name: str = ""
    origin: Path | None = field(default=None, init=False, compare=False, repr=False)

    def validate(self) -> None:
        """Raise ValueError naming the member at fault: shape, range, order, or not finite."""
        check_gaussians("background", self.background)
        for track_id, actor in self.actors.items():
            actor.validate(f"actors[{track_id!r}]")
            if actor.track_id != track_id:
                raise ValueError(f"actors[{track_id!r}].track_id: is {actor.track_id!r}")
        self.sky.validate()
        if self.world_offset.shape != (3,) or not np.all(np.isfinite(self.world_offset)):
            raise ValueError(f"world_offset: three finite metres, got {self.world_offset}")
        for name, (times, twists) in self.camera_corrections.items():
            where = f"camera_corrections[{name!r}]"
            check_times(where, times)
            if len(times) == 0 or twists.shape != (len(times), 6):
                raise ValueError(f"{where}: {len(times)} times, twists {twists.shape}")
            if not np.all(np.abs(twists) <= MOST_CORRECTED):  # also NaN
                raise ValueError(f"{where}: a twist is not finite, or beyond {MOST_CORRECTED:g}")

    def at(self, poses: Mapping[str, Array], timestamp_us: int | None = None) -> Gaussians:
        """Everything drawn when the actors stand at `poses`, in the world frame.

        Args:
            poses: `world_from_actor` (4, 4) by track id. Parked vehicles that it does not name
                stand where they are; other actors that it does not name are absent.
            timestamp_us: time of the recording whose shapes deformable actors have, see
                `SceneActor.shaped_at`.

        Raises:
            KeyError: a pose for an actor that the scene does not have.
        """
        parts = [self.background]
        for track_id, pose in {**self.standing, **poses}.items():
            actor = self.actors[track_id].shaped_at(timestamp_us).lit_at(pose)
            parts.append(actor.drawn.transformed(torch.from_numpy(np.array(pose))))
        return concatenate(parts)

    def actor_poses(self, timestamp_us: int) -> dict[str, Array]:
        """Logged (refined) `world_from_actor` of the actors present at a time."""
        poses = {
            track_id: pose_at(actor.trajectory, timestamp_us)
            for track_id, actor in self.actors.items()
        }
        return {track_id: pose for track_id, pose in poses.items() if pose is not None}

    @property
    def standing(self) -> dict[str, Array]:
        """Poses of the parked vehicles, which are part of the street: who does not move one draws
        it where it stands."""
        return {
            track_id: actor.trajectory.poses[0]
            for track_id, actor in self.actors.items()
            if stands(actor.trajectory)
        }

    def with_actor(self, actor: SceneActor | Insertable) -> StreetScene:
        """The scene with an actor added, or put in the place of the one with its track id.

        Args:
            actor: one of a scene; or a generated vehicle, see `recast.actors.insert`.
        """
        if not isinstance(actor, SceneActor):
            return actor.inserted_into(self)
        return replace(self, actors={**self.actors, actor.track_id: actor})

    def corrected_camera(
        self, camera_from_world: Array, camera_name: str, timestamp_us: int
    ) -> Array:
        """A logged camera pose (4, 4) with the learned correction at its time."""
        return corrected(camera_from_world, self.camera_corrections, camera_name, timestamp_us)

    def exposed(self, affine: Tensor) -> StreetScene:
        """The scene with the colours' transform (3, 4) in all its parts; the sky in [0, 1]."""
        return replace(
            self,
            background=exposed(self.background, affine),
            actors={name: actor.exposed(affine) for name, actor in self.actors.items()},
            sky=SkyMap(exposed_colours(self.sky.colours, affine).clamp(0, 1)),
        )
