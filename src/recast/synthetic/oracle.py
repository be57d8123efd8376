"""The true look of a synthetic world from anywhere, with any vehicle anywhere."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.geometry import PinholeCamera
from recast.synthetic.rendering import CameraFrame, RayScene, render_camera
from recast.synthetic.world import World

Array = NDArray[np.float64]

_STREAM = 601


class Oracle:
    """Renders a world by ray tracing.

    Parked vehicles are part of the street: they are always drawn, where they stand unless `poses`
    says otherwise. Moving ones are drawn only where `poses` has them. People walk and pedal by the
    way that they have gone, so that their poses tell their shapes.

    Args:
        world: any `World`; see `world_of` for that of a log.

    Raises:
        InputError: embreex is not installed.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self.scene = RayScene(
            world.street.surface, {key: v.model.surface for key, v in world.vehicles.items()}
        )
        self._parked = {k: v.trajectory.poses[0] for k, v in world.vehicles.items() if v.parked}

    def render(
        self,
        camera: PinholeCamera,
        world_from_camera: Array,
        poses: Mapping[str, Array] | None = None,
        timestamp_us: int | None = None,
        exposure: float = 1.0,
        rng: np.random.Generator | None = None,
    ) -> CameraFrame:
        """What a camera sees.

        Args:
            world_from_camera: (4, 4), OpenCV camera frame.
            poses: `world_from_actor` (4, 4) by track id; None for those of the log.
            timestamp_us: of the log, needed where `poses` is None.
            exposure: factor on all light.
            rng: of the rays; None for one that only the world's seed decides.

        Raises:
            InputError: `poses` names a vehicle that the world lacks.
            ValueError: neither poses nor a time are given, or a time outside the log.
        """
        if rng is None:
            rng = np.random.default_rng([self.world.seed, _STREAM])
        if poses is None:
            if timestamp_us is None:
                raise ValueError("Oracle.render: give poses or a timestamp_us")
            poses = self.logged_poses(timestamp_us)
        drawn = self.drawn(poses)
        return render_camera(
            self.scene_at(drawn),
            self.world.street.sky,
            camera,
            world_from_camera,
            drawn,
            rng=rng,
            exposure=exposure,
            quality=self.world.light,
        )

    def drawn(self, poses: Mapping[str, Array]) -> dict[str, Array]:
        """Poses of all that is drawn: `poses`, and the parked vehicles it does not name.

        Raises:
            InputError: `poses` names a vehicle that the world lacks.
        """
        for track_id in poses:
            if track_id not in self.world.vehicles:
                raise InputError(
                    self.world.name,
                    f"track {track_id}",
                    "is not in the synthetic world",
                    f"choose one of {', '.join(self.world.vehicles)}",
                )
        return {**self._parked, **poses}

    def scene_at(self, poses: Mapping[str, Array]) -> RayScene:
        """The scene in which people have the shapes of their poses, see `Vehicle.surface_at`."""
        shapes = {
            key: self.world.vehicles[key].surface_at(pose)
            for key, pose in poses.items()
            if self.world.vehicles[key].model.articulation is not None
        }
        return self.scene.with_models(shapes) if shapes else self.scene

    def logged_poses(self, timestamp_us: int) -> dict[str, Array]:
        """Poses of all vehicles at a time of the log; ValueError outside it."""
        vehicles = self.world.vehicles
        return {key: vehicle.trajectory.at(timestamp_us) for key, vehicle in vehicles.items()}

    def instance_of(self, track_id: str) -> int:
        """The value of a vehicle's pixels in `CameraFrame.instance`; KeyError for no such one."""
        return instances(self.world)[track_id]


def instances(world: World) -> dict[str, int]:
    """Instance values by track id: 1, 2, ... in the order of sorted ids; 0 is the street."""
    return {track_id: number for number, track_id in enumerate(sorted(world.vehicles), 1)}
