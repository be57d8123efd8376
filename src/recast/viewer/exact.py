"""The exact view: what the project's own rasterizer draws from where a browser's camera rests."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from recast.geometry import PinholeCamera, se3
from recast.scene import SceneRasterizer, StreetScene
from recast.viewer.inputs import Drive

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

WIDEST = 640
"""Pixels of an exact picture."""


@dataclass(frozen=True)
class Browser:
    """The camera of one browser window.

    Attributes:
        world_from_camera: (4, 4), OpenCV axes.
        fov: vertical, radians.
        aspect: width over height.
    """

    world_from_camera: Array
    fov: float
    aspect: float

    def pinhole(self, widest: int = WIDEST) -> PinholeCamera:
        """The same view at most `widest` pixels wide and high."""
        width = widest if self.aspect >= 1 else max(1, round(widest * self.aspect))
        height = max(1, round(width / self.aspect))
        focal = height / 2 / math.tan(self.fov / 2)
        return PinholeCamera(width, height, focal, focal, width / 2, height / 2)


class ExactView:
    """Draws scenes by arm; one picture at a time, as the rasterizer uses all cores.

    Args:
        scenes: by arm; None for arms without Gaussians.
    """

    def __init__(self, scenes: Mapping[str, StreetScene | None]) -> None:
        self._scenes = scenes
        self._rasterizers: dict[str, SceneRasterizer] = {}
        self._lock = Lock()

    def can(self, arm: str) -> bool:
        """Whether an arm has something to draw."""
        return self._scenes.get(arm) is not None

    def picture(self, arm: str, drive: Drive, step: int, browser: Browser) -> Image:
        """The scene of an arm (H, W, 3) RGB at a step of a drive, as a browser sees it.

        Raises:
            KeyError: the arm has no Gaussians.
        """
        scene = self._scenes.get(arm)
        if scene is None:
            raise KeyError(arm)
        poses = {key: pose for key, pose in drive.at(step).items() if key in scene.actors}
        with self._lock:
            if arm not in self._rasterizers:
                self._rasterizers[arm] = SceneRasterizer(scene)
            image = self._rasterizers[arm].render(
                browser.pinhole(), se3.inverse(browser.world_from_camera), poses,
                shapes_us=int(drive.times_us[step]),
            )  # fmt: skip
        return np.asarray(np.rint(image.rgb * 255), np.uint8)
