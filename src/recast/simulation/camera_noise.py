"""Small disturbances of a camera's image, below what a planner may depend on.

A planner whose verdict changes under them cannot agree better with the truth than with itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from recast.arrays import Image
from recast.simulation.renderer import RendererAround, SensorRenderer
from recast.simulation.state import SimState
from recast.synthetic.rig import sensor_number

ImageNoise = Literal["grey", "jitter"]
_STREAM = 702


class NoisyRenderer(RendererAround):
    """Images of another renderer, disturbed.

    Args:
        noise: "grey" (see `grey_noise`; another draw for each camera and step) or "jitter" (see
            `jittered`).
        seed: seed of the draws.
    """

    def __init__(self, renderer: SensorRenderer, noise: ImageNoise, seed: int) -> None:
        super().__init__(renderer)
        self._noise, self._seed = noise, seed

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Images of the named cameras; raises what the inner renderer raises."""
        images = self.part.render(state, camera_names)
        if self._noise == "jitter":
            return {name: self._jittered(name, image) for name, image in images.items()}
        return {
            name: grey_noise(image, np.random.default_rng(self._number(name, state.step)))
            for name, image in images.items()
        }

    def _jittered(self, name: str, image: Image) -> Image:
        """Of a camera with a window, what lies in it."""
        mount = self.mounts[name]
        return mount.framed(jittered(mount.windowed(image)))

    def _number(self, camera: str, step: int) -> list[int]:
        return [self._seed, _STREAM, sensor_number(camera), step]


def grey_noise(image: Image, rng: np.random.Generator) -> Image:
    """The image (H, W, 3) uint8 with each pixel one grey level up or down, its channels together.

    Black stays black when it goes down, and white stays white when it goes up.
    """
    step = 2 * rng.integers(0, 2, (*image.shape[:2], 1), np.int16) - 1
    return np.clip(image.astype(np.int16) + step, 0, 255).astype(np.uint8)


def jittered(image: Image) -> Image:
    """The image (H, W, 3) one pixel to the right, its left edge repeated."""
    return np.concatenate([image[:, :1], image[:, :-1]], axis=1)
