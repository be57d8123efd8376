"""Rendered images improved by a restorer, such as a diffusion model, before a planner sees them."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from copy import deepcopy
from os import PathLike
from typing import Any, Protocol

import numpy as np

from recast.arrays import Image
from recast.core.errors import InputError
from recast.core.foreign import BasePart, ForeignCode, read_only, whole
from recast.core.plugins import RESTORERS
from recast.simulation.renderer import RendererAround, SensorRenderer
from recast.simulation.state import SimState

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
