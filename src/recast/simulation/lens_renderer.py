"""Cameras with distortion, and virtual ones, through any renderer of pinhole cameras."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from recast.geometry import PinholeCamera
from recast.planning import CameraMount
from recast.planning.gtrs import Lens
from recast.simulation.renderer import SensorRenderer
from recast.simulation.state import SimState

Image = NDArray[np.uint8]


class LensRenderer:
    """Renders what another renderer cannot.

    Each distorted camera is rendered a little wider and without distortion, then the image is bent.
    Where no camera of the log looks (see `CameraMount.seen`), virtual ones are black.

    Args:
        renderer: of pinhole cameras; has a mount for each of `mounts`, with `Lens.source` in place
            of each distorted camera.
        mounts: the cameras as they shall be.
    """

    def __init__(self, renderer: SensorRenderer, mounts: Mapping[str, CameraMount]) -> None:
        self._renderer, self._mounts = renderer, dict(mounts)

    @property
    def mounts(self) -> Mapping[str, CameraMount]:
        """Cameras by name."""
        return self._mounts

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Images of the named cameras; raises what the inner renderer raises."""
        images = self._renderer.render(state, camera_names)
        for name in camera_names:
            mount = self._mounts[name]
            if not mount.camera.is_rectified:
                images[name] = _lens(mount.camera).bend(images[name])
            if mount.seen is not None:
                images[name] = images[name] * mount.seen[..., None]
        return images


def through_lenses(
    mounts: Mapping[str, CameraMount],
    make: Callable[[Mapping[str, CameraMount]], SensorRenderer],
) -> SensorRenderer:
    """A renderer of cameras of which some may have distortion, such as `nuplan_rig`, or be virtual.

    Args:
        mounts: cameras to render.
        make: gives a renderer of pinhole cameras for mounts. Where no camera has distortion and
            none is virtual, its renderer is returned as it is.
    """
    if all(mount.camera.is_rectified and mount.seen is None for mount in mounts.values()):
        return make(mounts)
    sources = {
        name: replace(
            mount,
            camera=mount.camera if mount.camera.is_rectified else _lens(mount.camera).source,
            seen=None,
        )
        for name, mount in mounts.items()
    }
    return LensRenderer(make(sources), mounts)


@lru_cache(maxsize=4)
def _lens(camera: PinholeCamera) -> Lens:
    # A map over all pixels: shared by cameras of one make, and by the rollouts of a run.
    return Lens(camera)
