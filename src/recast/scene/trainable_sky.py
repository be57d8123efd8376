"""The sky under training: a table of colours, put behind renderings; two layouts of its cells."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from recast.geometry import PinholeCamera
from recast.scene.adam_table import AdamTable
from recast.scene.config import SceneConfig
from recast.scene.cubemap import sample_cubemap, sky_from_cubemap, texel_directions
from recast.scene.sky import OPAQUE, SkyMap, composite, pixel_coordinates


class TrainableSky(Protocol):
    """What the trainer asks of a sky.

    Attributes:
        table: its colours, one row a cell.
    """

    table: AdamTable

    def behind(
        self, rgb: Tensor, alpha: Tensor, camera: PinholeCamera, camera_from_world: ArrayLike
    ) -> Tensor:
        """rgb + (1 - alpha) sky, (H, W, 3); pixels above `sky.OPAQUE` are left alone."""
        ...

    def sky_map(self) -> SkyMap:
        """The sky as it stands, copied to the CPU."""
        ...


def make_sky(config: SceneConfig, start: SkyMap) -> TrainableSky:
    """The sky that the configuration asks for, with the colours of `start`."""
    return CubeSky(start, config.sky_face_px) if config.sky == "cubemap" else PanoramaSky(start)


class PanoramaSky:
    """An equirectangular map: few cells, and what is learned is what is saved."""

    def __init__(self, start: SkyMap) -> None:
        self._shape = start.colours.shape
        self.table = AdamTable(start.colours.reshape(-1, 3))

    def behind(
        self, rgb: Tensor, alpha: Tensor, camera: PinholeCamera, camera_from_world: ArrayLike
    ) -> Tensor:
        """See `TrainableSky`."""
        coordinates = pixel_coordinates(camera, camera_from_world)
        return composite(rgb, alpha, self.table.value.view(self._shape), coordinates)

    def sky_map(self) -> SkyMap:
        """See `TrainableSky`."""
        return SkyMap(self.table.value.detach().view(self._shape).to("cpu", copy=True))


class CubeSky:
    """A cubemap in world axes, as both published trainers learn it (Street Gaussians, OmniRe).

    It is resampled for `sky_map`: the folder of a scene holds one kind of sky.
    """

    def __init__(self, start: SkyMap, face_px: int) -> None:
        self._shape = (6, face_px, face_px, 3)
        self.table = AdamTable(start(texel_directions(face_px).reshape(-1, 3)))

    def behind(
        self, rgb: Tensor, alpha: Tensor, camera: PinholeCamera, camera_from_world: ArrayLike
    ) -> Tensor:
        """See `TrainableSky`.

        Raises:
            ValueError: the camera has distortion.
        """
        flat = alpha.reshape(-1)
        shown = (flat.detach() < OPAQUE).nonzero()[:, 0]
        directions = _world_directions(camera, camera_from_world, shown)
        sky = sample_cubemap(self.table.value.view(self._shape), directions)
        through = 1 - flat.index_select(0, shown)
        return rgb.reshape(-1, 3).index_add(0, shown, through[:, None] * sky).view_as(rgb)

    def sky_map(self) -> SkyMap:
        """See `TrainableSky`."""
        return sky_from_cubemap(self.table.value.detach().cpu().view(self._shape), torch.eye(3))


def _world_directions(
    camera: PinholeCamera, camera_from_world: ArrayLike, pixels: Tensor
) -> Tensor:
    """Rays (M, 3) float32, depth 1, of flat pixel indices (M,) of a rectified camera."""
    if not camera.is_rectified:
        raise ValueError("the sky needs a rectified camera: use camera.rectified()")
    axes = torch.from_numpy(np.array(camera_from_world, np.float64)[:3, :3]).float()
    axes = axes.to(pixels.device)
    x = (pixels % camera.width + (0.5 - camera.cx)) / camera.fx
    y = (pixels // camera.width + (0.5 - camera.cy)) / camera.fy
    return x[:, None] * axes[0] + y[:, None] * axes[1] + axes[2]
