"""The sensor renderer over a synthetic world: what the cameras would truly see."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from recast.arrays import Array, Image
from recast.cameras import CameraMount, PinholeCamera
from recast.core.workers import Closing
from recast.simulation.renderer import MountedRenderer
from recast.simulation.state import SimState
from recast.synthetic.oracle import Oracle, OraclePool
from recast.synthetic.rendering import CameraFrame
from recast.synthetic.rig import exposure, sensor_number
from recast.synthetic.world import World

_STREAM = 701


class TrueView(NamedTuple):
    """One camera at one step, for an oracle in another process.

    Attributes:
        exposed_as: name of the log's camera whose exposure it has.
        poses: `world_from_actor` (4, 4) of the actors, by track id.
        tracks: those that a renderer leaves out or draws apart.
        noise: number of the camera noise; 0 is the truth's own.
    """

    name: str
    exposed_as: str
    camera: PinholeCamera
    world_from_camera: Array
    poses: Mapping[str, Array]
    step: int
    tracks: tuple[str, ...] = ()
    noise: int = 0

    def seen_by(self, oracle: Oracle, **shown: Any) -> CameraFrame:
        """What the camera truly sees; `shown` is as for `Oracle.render`."""
        seed = oracle.world.seed
        number = [seed, _STREAM, sensor_number(self.name), self.step]
        return oracle.render(
            self.camera,
            self.world_from_camera,
            self.poses,
            exposure=exposure(seed, self.exposed_as),
            rng=np.random.default_rng([*number, self.noise] if self.noise else number),
            **shown,
        )


class WorldRenderer(MountedRenderer, Closing):
    """Base of renderers that look at a synthetic world, each camera with the exposure it has in the
    log, virtual ones with that of the camera at whose place they are.

    Whole images are traced, also of a camera with a window: rays are drawn by chance and their
    light is averaged with the neighbours', so that a part alone would have other pixels.

    Close it, or use it as a context manager: it may hold processes.

    Args:
        world: see `recast.synthetic.populate.world_of`.
        mounts: cameras to render, see `camera_mounts`.
        workers: processes that render the cameras of a step side by side; 0 for one for each core,
            but not more than cameras; 1 for none.
        tracks: see `TrueView`.
        noise: see `TrueView`.
        pool: pool of the same world, whose processes render instead of own ones; closing leaves it
            open.

    Raises:
        InputError: workers is negative, or embreex is not installed.
    """

    def __init__(
        self,
        world: World,
        mounts: Mapping[str, CameraMount],
        workers: int = 0,
        *,
        tracks: Collection[str] = (),
        noise: int = 0,
        pool: OraclePool | None = None,
    ) -> None:
        super().__init__(mounts)
        self._tracks, self._noise = tuple(tracks), noise
        self._own_pool = pool is None
        self._pool = OraclePool(world, workers, most=len(self._mounts)) if pool is None else pool

    def views(self, state: SimState, camera_names: Sequence[str]) -> list[TrueView]:
        """What is to be looked at for the named cameras."""
        found = []
        for name in camera_names:
            mount = self._mounts[name]
            place = state.world_from_rig @ mount.rig_from_camera
            exposed_as = name if mount.source is None else mount.source
            view = TrueView(name, exposed_as, mount.camera, place, state.poses, state.step)
            found.append(view._replace(tracks=self._tracks, noise=self._noise))
        return found

    def close(self) -> None:
        """End its own processes."""
        if self._own_pool:
            self._pool.close()


class OracleRenderer(WorldRenderer):
    """Renders a synthetic world, without the vehicles of `tracks`; see `WorldRenderer`."""

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Render the world with its vehicles at the poses of `state`.

        Raises:
            InputError: the world has no such vehicle.
        """
        views = self.views(state, camera_names)
        images = zip(camera_names, self._pool.map(_render, views), strict=True)
        return {name: self._mounts[name].masked(image) for name, image in images}


def _render(oracle: Oracle, view: TrueView) -> Image:
    return view.seen_by(oracle, absent=view.tracks).rgb
