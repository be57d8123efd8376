"""Images of a frozen scene, for evaluation and simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch

from recast.arrays import Array, Float32Array
from recast.cameras import PinholeCamera
from recast.scene.actor import DrawnActor
from recast.scene.sky import composite, pixel_coordinates
from recast.scene.street_scene import StreetScene
from recast.splats import (
    RasterImages,
    Window,
    freeze,
    morton_order,
    pick_device,
    rasterize_frozen,
)

_FAR = 1e10
"""Metres; all that is farther is sky."""


@dataclass(frozen=True)
class SceneImage:
    """One rendered view.

    Attributes:
        rgb: (H, W, 3) float32 in [0, 1].
        depth: (H, W) float32, sum of T alpha z in metres, not divided by alpha.
        alpha: (H, W) float32 accumulated opacity; the rest is sky.
    """

    rgb: Float32Array
    depth: Float32Array
    alpha: Float32Array


class SceneRasterizer:
    """Draws one scene again and again: what does not change is worked out once.

    Args:
        device: device to draw on, see `recast.splats.pick_device`.

    Raises:
        InputError: there is no such device, or gsplat is missing.
    """

    def __init__(self, scene: StreetScene, device: str = "auto") -> None:
        place = pick_device(device)
        self._standing = scene.standing
        self._sky = scene.sky.colours.to(place)
        background = scene.background.detach()
        self._background = freeze(background.select(morton_order(background.means)).to(place))
        self._actors = {
            track_id: DrawnActor(actor, place) for track_id, actor in scene.actors.items()
        }

    def render(
        self,
        camera: PinholeCamera,
        camera_from_world: Array,
        poses: Mapping[str, Array],
        colours_us: int | None = None,
        shapes_us: int | None = None,
    ) -> SceneImage:
        """Draw one view; see `render_scene` and `draw`."""
        drawn = self.draw(camera, camera_from_world, poses, colours_us, shapes_us)
        return SceneImage(
            rgb=drawn.rgb.cpu().numpy(),
            depth=drawn.depth.cpu().numpy(),
            alpha=drawn.alpha.cpu().numpy(),
        )

    def draw(
        self,
        camera: PinholeCamera,
        camera_from_world: Array,
        poses: Mapping[str, Array],
        colours_us: int | None = None,
        shapes_us: int | None = None,
        window: Window | None = None,
    ) -> RasterImages:
        """Draw one view and leave it where it was drawn, sky included, rgb in [0, 1].

        Args:
            window: the part of the camera's image to draw, with the pixels of the whole image; None
                for all of it.
            colours_us: time of the recording whose colours the actors have, where they change; None
                for those that they are stored with.
            shapes_us: time of the recording whose shapes deformable actors have, see
                `SceneActor.shaped_at`.
        """
        result = self.layer(camera, camera_from_world, poses, colours_us, shapes_us, window=window)
        left, top, right, bottom = window or (0, 0, camera.width, camera.height)
        # Interpolated between nodes of the whole image.
        coordinates = pixel_coordinates(camera, camera_from_world)[top:bottom, left:right]
        with torch.no_grad():
            rgb = composite(result.rgb, result.alpha, self._sky, coordinates)
        return replace(result, rgb=rgb.clamp(0, 1))

    def layer(
        self,
        camera: PinholeCamera,
        camera_from_world: Array,
        poses: Mapping[str, Array],
        colours_us: int | None = None,
        shapes_us: int | None = None,
        *,
        nearer_than: float = _FAR,
        street: bool = True,
        window: Window | None = None,
    ) -> RasterImages:
        """Draw Gaussians alone: rgb is premultiplied, on black, without a sky; others as `draw`.

        Args:
            nearer_than: only Gaussians whose centres lie nearer, metres along the camera's z axis.
            street: False leaves out all but the actors of `poses`.

        Raises:
            ValueError: neither street nor actors are to be drawn.
        """
        view = torch.from_numpy(np.asarray(camera_from_world, np.float64))
        K = torch.from_numpy(camera.matrix).float()
        drawn = [(self._background, torch.eye(4, dtype=torch.float64))] if street else []
        for track_id, pose in {**(self._standing if street else {}), **poses}.items():
            world_from_actor = torch.from_numpy(np.array(pose, np.float64))
            for part in self._actors[track_id].at(pose, colours_us, shapes_us):
                drawn.append((part, world_from_actor))
        with torch.no_grad():
            return rasterize_frozen(
                drawn, view, K, camera.width, camera.height, far=nearer_than, window=window
            )


def render_scene(
    scene: StreetScene,
    camera: PinholeCamera,
    camera_from_world: Array,
    poses: Mapping[str, Array],
) -> SceneImage:
    """Draw a scene once. For many images of one scene keep a `SceneRasterizer`.

    Args:
        camera: rectified intrinsics.
        camera_from_world: (4, 4).
        poses: `world_from_actor` (4, 4) by track id. Parked vehicles that it does not name are
            drawn where they stand; other actors that it does not name are not drawn.

    Raises:
        ValueError: the camera has distortion.
        KeyError: a pose for an actor that the scene does not have.
    """
    return SceneRasterizer(scene).render(camera, camera_from_world, poses)
