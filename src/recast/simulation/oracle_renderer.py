"""The sensor renderer over a synthetic world: what the cameras would truly see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from recast.arrays import Array, Image
from recast.core.workers import Closing
from recast.planning import CameraMount
from recast.simulation.renderer import Mounted
from recast.simulation.state import SimState
from recast.synthetic.oracle import Oracle, OraclePool
from recast.synthetic.rig import exposure, sensor_number
from recast.synthetic.world import World

_STREAM = 701


class _View(NamedTuple):
    name: str
    exposed_as: str
    mount: CameraMount
    world_from_camera: Array
    poses: dict[str, Array]
    step: int


class OracleRenderer(Mounted, Closing):
    """Renders a synthetic world, each camera with the exposure it has in the log, virtual ones with
    that of the camera at whose place they are.

    Close it, or use it as a context manager: it may hold processes.

    Args:
        world: see `recast.synthetic.populate.world_of`.
        mounts: cameras to render, see `camera_mounts`.
        workers: processes that render the cameras of a step side by side; 0 for one for each core,
            but not more than cameras; 1 for none.

    Raises:
        InputError: workers is negative, or embreex is not installed.
    """

    def __init__(self, world: World, mounts: Mapping[str, CameraMount], workers: int = 0) -> None:
        super().__init__(mounts)
        self._pool = OraclePool(world, workers, most=len(self._mounts))

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Render the world with its vehicles at the poses of `state`.

        Raises:
            InputError: the world has no such vehicle.
        """
        views = []
        for name in camera_names:
            mount = self._mounts[name]
            world_from_camera = state.world_from_rig @ mount.rig_from_camera
            exposed_as = name if mount.source is None else mount.source
            views.append(_View(name, exposed_as, mount, world_from_camera, state.poses, state.step))
        return dict(zip(camera_names, self._pool.map(_render, views), strict=True))

    def close(self) -> None:
        """End the processes."""
        self._pool.close()


def _render(oracle: Oracle, view: _View) -> Image:
    seed = oracle.world.seed
    frame = oracle.render(
        view.mount.rendered_camera,
        view.world_from_camera,
        view.poses,
        exposure=exposure(seed, view.exposed_as),
        rng=np.random.default_rng([seed, _STREAM, sensor_number(view.name), view.step]),
    )
    return view.mount.framed(frame.rgb)
