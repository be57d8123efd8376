"""The seam behind which backgrounds are removed."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Cutout(Protocol):
    """What a remover found; `recast.actors.Segmentation` is one."""

    @property
    def alpha(self) -> NDArray[np.uint8]:
        """(H, W), 255 on the vehicle."""

    @property
    def doubts(self) -> tuple[str, ...]:
        """What a person should look at."""


class BackgroundRemover(Protocol):
    """Finds the one vehicle in a photograph; see `recast.actors.cutout` for two that do."""

    def remove(self, image: NDArray[np.uint8], category: str) -> Cutout:
        """The mask of the vehicle in a picture (H, W, 3) uint8 RGB.

        Raises:
            InputError: no vehicle was found.
        """
