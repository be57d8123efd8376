"""A reconstructed street: what never moves, what does, and the sky."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
import torch

from recast.arrays import Array, Int64Array
from recast.logs import Trajectory
from recast.logs.checks import BOX_SIDE, check_times
from recast.scene.appearance import Appearance, share_of
from recast.scene.dynamic import pose_at, stands
from recast.scene.poses import corrected
from recast.scene.sky import SkyMap
from recast.splats import CLASSIC, Gaussians, LowPass, concatenate

MOST_CORRECTED = 100.0
"""Largest learned correction of a camera, metres or radians."""


class Lighting(Protocol):
    """What lights an actor anew, wherever it stands; see `recast.scene.light`."""

    @property
    def shadow_room(self) -> int:
        """Most Gaussians that the lit actor's shadow has."""

    def lit(self, actor: SceneActor, pose: Array) -> SceneActor:
        """The actor in the light of `pose` (4, 4) `world_from_actor`, its `light` taken off.

        Colours and shadow are others; shapes and opacities stay.
        """


class Deforming(Protocol):
    """What moves the Gaussians of an actor within its box; see `recast.scene.deformation`."""

    def validate(self, where: str, count: int) -> None:
        """Raise ValueError naming the member at fault of an actor `where` of `count` Gaussians."""

    def at(self, gaussians: Gaussians, trajectory: Trajectory, timestamp_us: int) -> Gaussians:
        """The Gaussians as they are at a time of the recording; outside of it, at its end."""


class Insertable(Protocol):
    """What can take an actor's place in a scene, such as `recast.actors.Actor`."""

    def inserted_into(self, scene: StreetScene) -> StreetScene:
        """The scene with it in the place of the actor with its track id."""


@dataclass(frozen=True)
class SceneActor:
    """One moving object.

    Attributes:
        gaussians: actor-local frame (box centre, x forward, y left, z up).
        size: (3,) length, width, height in metres.
        trajectory: refined `world_from_actor` as logged.
        shadow: actor-local Gaussians on the ground, drawn with the actor, or None.
        appearance: how the Gaussians' colours change over the trajectory's time, or None.
        deformation: how the Gaussians move within the box over the trajectory's time, or None for a
            rigid actor.
        low_pass: the filter that the Gaussians were made for, see `recast.splats.refiltered`.
        light: what lights it anew where it stands, or None for an actor that keeps the light it was
            recorded in. Not saved with a scene.
    """

    track_id: str
    gaussians: Gaussians
    size: Array
    trajectory: Trajectory
    shadow: Gaussians | None = None
    appearance: Appearance | None = None
    deformation: Deforming | None = None
    low_pass: LowPass = CLASSIC
    light: Lighting | None = None

    def validate(self, where: str) -> None:
        """Raise ValueError naming the member of `where` at fault."""
        least, most = BOX_SIDE
        if self.size.shape != (3,) or not np.all((self.size >= least) & (self.size <= most)):
            raise ValueError(f"{where}.size: three metres of {least} to {most}, got {self.size}")
        self.trajectory.validate(where)
        _validate(f"{where}.gaussians", self.gaussians)
        if self.shadow is not None:
            _validate(f"{where}.shadow", self.shadow)
        if self.appearance is not None:
            self.appearance.validate(where, len(self.gaussians))
        if self.deformation is not None:
            self.deformation.validate(f"{where}.deformation", len(self.gaussians))

    def coloured_at(self, timestamp_us: int) -> SceneActor:
        """The actor with the colours that it had at a time of the recording."""
        if self.appearance is None:
            return self
        share = share_of(self.trajectory, timestamp_us)
        return replace(self, gaussians=self.appearance.at(self.gaussians, share), appearance=None)

    def shaped_at(self, timestamp_us: int | None) -> SceneActor:
        """The actor with the shape that it had at a time of the recording, and rigid.

        Args:
            timestamp_us: time of the recording; None for the middle of the actor's time.
        """
        if self.deformation is None:
            return self
        first, last = (int(time) for time in self.trajectory.timestamps_us[[0, -1]])
        time = (first + last) // 2 if timestamp_us is None else timestamp_us
        with torch.no_grad():
            shaped = self.deformation.at(self.gaussians, self.trajectory, time)
        return replace(self, gaussians=shaped, deformation=None)

    def lit_at(self, pose: Array) -> SceneActor:
        """The actor in the light of `pose` (4, 4) `world_from_actor`."""
        return self if self.light is None else self.light.lit(self, pose)

    @property
    def drawn(self) -> Gaussians:
        """Gaussians and shadow together, actor-local; a deformable actor as `shaped_at(None)`."""
        gaussians = self.shaped_at(None).gaussians
        return gaussians if self.shadow is None else concatenate([gaussians, self.shadow])


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
        _validate("background", self.background)
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


def _validate(where: str, gaussians: Gaussians) -> None:
    fault = gaussians.fault()
    if fault is not None:
        raise ValueError(f"{where}.{fault[0]}: {fault[1]}")
