"""What the cameras see at a step of the simulation."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, Self

import numpy as np

from recast.arrays import Array, Image
from recast.cameras import CameraMount, PinholeCamera
from recast.core.errors import InputError
from recast.core.foreign import Around, BasePart, whole
from recast.logs.types import DrivingLog
from recast.simulation.state import SimState


class SensorRenderer(Protocol):
    """Renders cameras; its images depend on nothing but the state.

    These members are enough; `BaseRenderer` has all others, with their defaults.

    Attributes:
        mounts: the cameras it can render, by name, as the images have them.
    """

    @property
    def mounts(self) -> Mapping[str, CameraMount]:
        """Cameras by name."""

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Images (height, width, 3) uint8 RGB of the named cameras at `state`."""


def camera_mounts(
    log: DrivingLog, camera_names: Sequence[str] | None = None, scale: float = 1.0
) -> dict[str, CameraMount]:
    """The log's cameras, rectified and resized.

    Args:
        camera_names: names of the cameras; None for all.
        scale: factor on width and height, which are rounded to whole pixels.

    Raises:
        InputError: a camera is not in the log.
    """
    mounts = {}
    for name in log.cameras if camera_names is None else camera_names:
        if name not in log.cameras:
            raise InputError(
                log.name,
                f"camera {name}",
                "is not in the log",
                f"choose one of {', '.join(log.cameras)}",
            )
        stream = log.cameras[name]
        mounts[name] = camera_mount(stream.camera, stream.rig_from_camera, scale)
    return mounts


def camera_mount(camera: PinholeCamera, rig_from_camera: Array, scale: float = 1.0) -> CameraMount:
    """A camera, rectified and resized; see `camera_mounts`."""
    size = round(camera.width * scale), round(camera.height * scale)
    return CameraMount(camera.rectified().resized(*size), rig_from_camera)


class BaseRenderer(BasePart):
    """A `SensorRenderer` with all members that are asked for: derive yours from it."""

    @property
    @abstractmethod
    def mounts(self) -> Mapping[str, CameraMount]:
        """Cameras by name."""

    @abstractmethod
    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Images (height, width, 3) uint8 RGB of the named cameras at `state`."""

    def close(self) -> None:
        """End processes and connections that it holds."""

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Itself: copies of a simulation share one renderer, as its images depend on the state."""
        return self


class RendererAround(Around, BaseRenderer):
    """Base of renderers that change the images of another one.

    Args:
        renderer: the other one, of any class.
    """

    def __init__(self, renderer: SensorRenderer) -> None:
        super().__init__(whole(renderer, BaseRenderer))

    @property
    def mounts(self) -> Mapping[str, CameraMount]:
        """Cameras by name."""
        return self.part.mounts


class MountedRenderer(BaseRenderer):
    """Base of renderers: the cameras that they were given."""

    def __init__(self, mounts: Mapping[str, CameraMount]) -> None:
        self._mounts = dict(mounts)

    @property
    def mounts(self) -> Mapping[str, CameraMount]:
        """Cameras by name."""
        return self._mounts


class NullRenderer(MountedRenderer):
    """Black images: to try an image-conditioned planner's plumbing without a scene."""

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """One black image a camera."""
        cameras = {name: self._mounts[name].camera for name in camera_names}
        return {n: np.zeros((c.height, c.width, 3), np.uint8) for n, c in cameras.items()}
