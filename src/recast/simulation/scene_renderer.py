"""Renderers that need torch: of a reconstructed street scene, and of cameras with distortion."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch

from recast.arrays import Array, Image
from recast.cameras import CameraMount, Lens, PinholeCamera
from recast.core.errors import InputError
from recast.core.foreign import whole
from recast.geometry import se3
from recast.scene.street_scene import SceneRasterizer, StreetScene
from recast.simulation.renderer import BaseRenderer, MountedRenderer, SensorRenderer
from recast.simulation.rollout import SimState
from recast.splats import Window


class SceneRenderer(MountedRenderer):
    """Renders a reconstructed street scene.

    Args:
        scene: scene in the log's world frame; must hold the controlled actors.
        mounts: cameras to render, see `camera_mounts`.
        device: device to render on, see `SceneRasterizer`.
        absent: tracks that are not drawn, wherever they are.
    """

    def __init__(
        self,
        scene: StreetScene,
        mounts: Mapping[str, CameraMount],
        device: str = "auto",
        absent: Collection[str] = (),
    ) -> None:
        kept = {key: actor for key, actor in scene.actors.items() if key not in absent}
        scene = scene if len(kept) == len(scene.actors) else replace(scene, actors=kept)
        self.scene, self._absent = scene, frozenset(absent)
        self.rasterizer = SceneRasterizer(scene, device)
        super().__init__(mounts)

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Render the scene with its actors at the poses of `state`.

        Raises:
            InputError: the scene has no model of a controlled actor.
        """
        poses = self.poses(state)
        images = {}
        for name in camera_names:
            mount = self._mounts[name]
            camera_from_world = se3.inverse(state.world_from_rig @ mount.rig_from_camera)
            image = draw_image(
                self.rasterizer,
                mount.camera,
                camera_from_world,
                poses,
                state.timestamp_us,
                mount.window,
            )
            images[name] = mount.framed(image)
        return images

    def poses(self, state: SimState) -> dict[str, Array]:
        """`world_from_actor` (4, 4) of the actors that are drawn, by track id.

        Raises:
            InputError: the scene has no model of a controlled actor.
        """
        for track_id in state.actors:
            if track_id not in self.scene.actors and track_id not in self._absent:
                there = ", ".join(self.scene.actors) or "none"
                raise InputError(
                    "scene",
                    f"actor {track_id}",
                    "has no model in the scene",
                    f"reconstruct or insert the actor first; the scene has models of {there}",
                )
        # Other tracks that the scene modelled as background cannot be moved or drawn apart.
        return {key: pose for key, pose in state.poses.items() if key in self.scene.actors}


def draw_image(
    rasterizer: SceneRasterizer,
    camera: PinholeCamera,
    camera_from_world: Array,
    poses: Mapping[str, Array],
    timestamp_us: int,
    window: Window | None = None,
) -> Image:
    """An image (height, width, 3) uint8 RGB of a rectified camera; see `SceneRasterizer.draw`.

    Args:
        timestamp_us: time of the recording whose shapes deformable actors have.
        window: the part of the image to draw; None for all of it.
    """
    drawn = rasterizer.draw(camera, camera_from_world, poses, shapes_us=timestamp_us, window=window)
    # Quantised where it was drawn: a quarter of the bytes to bring over.
    return (drawn.rgb * 255).round().to(torch.uint8).cpu().numpy()


class LensRenderer(MountedRenderer):
    """Renders what another renderer cannot.

    Each distorted camera is rendered a little wider and without distortion, then the image is bent;
    one with a wide field of view is put together from several images, see `Lens.faces`. Where no
    camera of the log looks (see `CameraMount.seen`), virtual ones are black.

    Args:
        renderer: renderer of pinhole cameras; has the mounts that `pinhole_mounts` gives for each
            of `mounts`.
        mounts: the cameras as they shall be.
    """

    def __init__(self, renderer: SensorRenderer, mounts: Mapping[str, CameraMount]) -> None:
        super().__init__(mounts)
        self._renderer = whole(renderer, BaseRenderer)
        self._parts = {name: tuple(pinhole_mounts(name, mount)) for name, mount in mounts.items()}

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Images of the named cameras; raises what the inner renderer raises."""
        parts = [part for name in camera_names for part in self._parts[name]]
        drawn = self._renderer.render(state, parts)
        images = {}
        for name in camera_names:
            mount, own = self._mounts[name], [drawn[part] for part in self._parts[name]]
            image = own[0] if mount.camera.is_rectified else _lens(mount.camera).bend(*own)
            images[name] = image if mount.seen is None else image * mount.seen[..., None]
        return images

    def close(self) -> None:
        """Close the inner renderer."""
        self._renderer.close()


def pinhole_mounts(name: str, mount: CameraMount) -> dict[str, CameraMount]:
    """The rectified cameras that a camera's image is put together from, by name; the first has the
    camera's own name."""
    if mount.camera.is_rectified:
        return {name: replace(mount, seen=None)}
    mounts = {}
    for index, face in enumerate(_lens(mount.camera).faces):
        turn = se3.from_rotation_translation(face.face_from_lens.T, np.zeros(3))
        source = name if index and mount.source is None else mount.source
        own = f"{name}, face {index}" if index else name
        mounts[own] = CameraMount(face.camera, mount.rig_from_camera @ turn, None, source)
    return mounts


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
        k: v for name, mount in mounts.items() for k, v in pinhole_mounts(name, mount).items()
    }
    return LensRenderer(make(sources), mounts)


@lru_cache(maxsize=4)
def _lens(camera: PinholeCamera) -> Lens:
    # A map over all pixels: shared by cameras of one make, and by the rollouts of a run.
    return Lens(camera)
