"""Half truth, half reconstruction: the true vehicle in a street of Gaussians, and the reverse.

They tell what a wrong verdict is made of: the street or the vehicle.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from recast.arrays import Array, Float32Array, Image
from recast.cameras import CameraMount
from recast.geometry import se3
from recast.scene.render import SceneRasterizer
from recast.scene.street_scene import StreetScene
from recast.simulation.compositing import (
    as_image,
    gaussians_in_truth,
    light_left,
    shaded,
    vehicle_in_street,
)
from recast.simulation.oracle_renderer import TrueView, WorldRenderer
from recast.simulation.scene_renderer import SceneRenderer
from recast.simulation.state import SimState
from recast.splats import RasterImages
from recast.synthetic import World
from recast.synthetic.oracle import Oracle, OraclePool
from recast.synthetic.rendering import CameraFrame

_CLEARANCE_M = 0.5
"""What is to hide a vehicle is nearer than its nearest point by that: splats of the road at its
wheels are large."""


class _TrueParts(NamedTuple):
    """What a true vehicle brings into an image.

    Attributes:
        left: (H, W, 3) see `light_left`.
        vehicles: each alone, the farthest first.
    """

    left: Float32Array
    vehicles: list[CameraFrame]


class TrueVehicleRenderer(WorldRenderer):
    """The true vehicles of some tracks in a reconstructed street, with their true light and shadow.

    The street's Gaussians hide a vehicle where their centres are nearer than its nearest point.

    Args:
        world: see `WorldRenderer`, as for `mounts`, `workers` and `pool`.
        scene: the street; its own models of the tracks are left out.
        tracks: tracks whose vehicles are the true ones.
    """

    def __init__(
        self,
        world: World,
        scene: StreetScene,
        mounts: Mapping[str, CameraMount],
        workers: int = 0,
        *,
        tracks: Collection[str],
        pool: OraclePool | None = None,
    ) -> None:
        super().__init__(world, mounts, workers, tracks=tracks, pool=pool)
        self._street = SceneRenderer(scene, mounts, absent=tracks)

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Render the street with its actors and the true vehicles at the poses of `state`.

        Raises:
            InputError: the world has no such vehicle, or the scene no model of another actor.
        """
        views = self.views(state, camera_names)
        parts = self._pool.map(_true_parts, views)
        poses, time = self._street.poses(state), state.timestamp_us
        return {
            view.name: self._mounts[view.name].masked(self._composed(view, part, poses, time))
            for view, part in zip(views, parts, strict=True)
        }

    def _composed(
        self, view: TrueView, parts: _TrueParts, poses: Mapping[str, Array], time: int
    ) -> Image:
        camera, camera_from_world = view.camera, se3.inverse(view.world_from_camera)
        rasterizer = self._street.rasterizer
        drawn = rasterizer.draw(camera, camera_from_world, poses, shapes_us=time)
        image = shaded(drawn.rgb.cpu().numpy(), parts.left)
        for vehicle in parts.vehicles:
            nearest = float(vehicle.depth.min()) - _CLEARANCE_M
            front = rasterizer.layer(
                camera, camera_from_world, poses, shapes_us=time, nearer_than=max(nearest, 0.3)
            )
            rgb, alpha, _ = _arrays(front)
            image = vehicle_in_street(image, rgb, alpha, vehicle.rgb, vehicle.alpha)
        return as_image(image)


def _true_parts(oracle: Oracle, view: TrueView) -> _TrueParts:
    beside = view.seen_by(oracle, hidden=view.tracks)
    without = view.seen_by(oracle, absent=view.tracks)
    alone = [view.seen_by(oracle, alone=(track,)) for track in view.tracks]
    seen = [frame for frame in alone if np.isfinite(frame.depth).any()]
    seen.sort(key=lambda frame: -float(frame.depth.min()))
    return _TrueParts(light_left(beside.rgb, without.rgb), seen)


class GeneratedVehicleRenderer(WorldRenderer):
    """The Gaussians of some tracks' vehicles, with their shadows, in the true street.

    Args:
        world: see `WorldRenderer`, as for `mounts`, `workers` and `pool`.
        scene: has the vehicles as actors, which bring their light; its street is not drawn.
        tracks: tracks whose vehicles are those of the scene.
    """

    def __init__(
        self,
        world: World,
        scene: StreetScene,
        mounts: Mapping[str, CameraMount],
        workers: int = 0,
        *,
        tracks: Collection[str],
        pool: OraclePool | None = None,
    ) -> None:
        super().__init__(world, mounts, workers, tracks=tracks, pool=pool)
        self._rasterizer = SceneRasterizer(scene)

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Render the world, and the vehicles of the scene at the poses of `state`.

        Raises:
            InputError: the world has no such vehicle.
            KeyError: the scene has no such actor.
        """
        views = self.views(state, camera_names)
        frames = self._pool.map(_street_alone, views)
        poses = {track: pose for track, pose in state.poses.items() if track in self._tracks}
        images = {}
        for view, frame in zip(views, frames, strict=True):
            camera_from_world = se3.inverse(view.world_from_camera)
            layer = self._rasterizer.layer(
                view.camera, camera_from_world, poses, shapes_us=state.timestamp_us, street=False
            )
            rgb, alpha, depth = _arrays(layer)
            image = gaussians_in_truth(frame.rgb, frame.depth, rgb, depth, alpha)
            images[view.name] = self._mounts[view.name].masked(image)
        return images


def _street_alone(oracle: Oracle, view: TrueView) -> CameraFrame:
    return view.seen_by(oracle, absent=view.tracks)


def _arrays(drawn: RasterImages) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Colour, opacity and depth, see `RasterImages`."""
    return drawn.rgb.cpu().numpy(), drawn.alpha.cpu().numpy(), drawn.depth.cpu().numpy()
