"""What the cameras see at a step of the simulation: renderers, and restorers of their images."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from copy import deepcopy
from os import PathLike
from typing import Any, Protocol, Self

import numpy as np

from recast.arrays import Array, Image
from recast.cameras import CameraMount, PinholeCamera
from recast.core.errors import InputError
from recast.core.foreign import Around, BasePart, ForeignCode, read_only, whole
from recast.core.plugins import RESTORERS
from recast.logs.types import DrivingLog
from recast.simulation.rollout import SimState


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


def jittered(image: Image) -> Image:
    """The image (H, W, 3) one pixel to the right, its left edge repeated."""
    return np.concatenate([image[:, :1], image[:, :-1]], axis=1)


_MEND = "return one image of the same size for each name, uint8 RGB"


class Restorer(Protocol):
    """Improves images. These members are enough; `BaseRestorer` has all others.

    Attributes:
        name: name of the restorer, for records.
    """

    name: str

    def restore(self, images: Mapping[str, Image]) -> Mapping[str, Image]:
        """Images of the same names, sizes and type.

        Args:
            images: (height, width, 3) uint8 RGB by camera name, all of one step.
        """


class BaseRestorer(BasePart):
    """A `Restorer` with all members that are asked for: derive yours from it."""

    name: str

    @abstractmethod
    def restore(self, images: Mapping[str, Image]) -> Mapping[str, Image]:
        """Images of the same names, sizes and type, see `Restorer`."""


class RestoringRenderer(RendererAround):
    """Images of another renderer, restored.

    Only what was rendered is handed over, and what no camera of the log looks at stays black (see
    `CameraMount`): a restorer must not invent it.

    Attributes:
        restored_by: name of the restorer, for records.
    """

    def __init__(self, renderer: SensorRenderer, restorer: Restorer) -> None:
        super().__init__(renderer)
        self._restorer = whole(restorer, BaseRestorer)
        self.restored_by = self._restorer.name

    def __deepcopy__(self, memo: dict[int, Any]) -> RestoringRenderer:
        """One with a restorer of its own in the same state: restorers may remember images."""
        return RestoringRenderer(deepcopy(self.part, memo), deepcopy(self._restorer, memo))

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Restored images of the named cameras; raises what renderer and restorer raise.

        Raises:
            InputError: the restorer leaves out an image, or returns one of another size or type.
        """
        rendered = self.part.render(state, camera_names)
        if not rendered:
            return rendered
        parts = {name: self.mounts[name].windowed(image) for name, image in rendered.items()}
        with ForeignCode(f"restorer {self.restored_by}", state.step).call("restore"):
            found = self._restorer.restore(read_only(parts))
        return {name: self._framed(name, part, found) for name, part in parts.items()}

    def _framed(self, name: str, part: Image, found: Mapping[str, Image]) -> Image:
        image, mount = found.get(name), self.mounts[name]
        problem = None
        if not isinstance(image, np.ndarray):
            problem = "no image was returned"
        elif image.shape != part.shape or image.dtype != np.uint8:
            problem = f"is {image.dtype} {image.shape}, not uint8 {part.shape}"
        if image is None or problem is not None:
            raise InputError(f"restorer {self.restored_by}", name, problem or "", _MEND)
        framed = mount.framed(image)
        return framed if mount.seen is None else framed * mount.seen[..., None]


def make_restorer(restorer: str | PathLike[str] | Restorer) -> BaseRestorer:
    """Make a restorer, or return the one given, with all members that it lacks.

    Args:
        restorer: "harmonizer:HOST:PORT"; or the name of an installed one; or
            "package.module:attribute" of a class or function that returns a `Restorer` when it is
            called without arguments; or a `Restorer`. See `recast.core.plugins.Registry.resolve`.

    Raises:
        InputError: it is none of these.
    """
    return whole(RESTORERS.resolve(restorer), BaseRestorer)
