"""Renderers that need torch: of a reconstructed street scene, and of cameras with distortion."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import torch

from recast.arrays import Array, Image
from recast.core.errors import InputError
from recast.geometry import PinholeCamera, se3
from recast.planning import CameraMount, Lens
from recast.scene.render import SceneRasterizer
from recast.scene.street_scene import StreetScene
from recast.simulation.renderer import Mounted, SensorRenderer
from recast.simulation.state import SimState


class SceneRenderer(Mounted):
    """Renders a reconstructed street scene.

    Args:
        scene: in the log's world frame; must hold the controlled actors.
        mounts: cameras to render, see `camera_mounts`.
        device: where to render, see `SceneRasterizer`.
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
            drawn = self.rasterizer.draw(
                mount.rendered_camera, camera_from_world, poses, shapes_us=state.timestamp_us
            )
            # Quantised where it was drawn: a quarter of the bytes to bring over.
            rgb = (drawn.rgb * 255).round().to(torch.uint8).cpu().numpy()
            images[name] = mount.framed(rgb)
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
                    f"it has {there}; reconstruct or insert it first",
                )
        # Other tracks that the scene modelled as background cannot be moved or drawn apart.
        return {key: pose for key, pose in state.poses.items() if key in self.scene.actors}


class LensRenderer(Mounted):
    """Renders what another renderer cannot.

    Each distorted camera is rendered a little wider and without distortion, then the image is bent.
    Where no camera of the log looks (see `CameraMount.seen`), virtual ones are black.

    Args:
        renderer: of pinhole cameras; has a mount for each of `mounts`, with `Lens.source` in place
            of each distorted camera.
        mounts: the cameras as they shall be.
    """

    def __init__(self, renderer: SensorRenderer, mounts: Mapping[str, CameraMount]) -> None:
        super().__init__(mounts)
        self._renderer = renderer

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
        name: replace(mount, seen=None)
        if mount.camera.is_rectified
        else replace(mount, camera=_lens(mount.camera).source, seen=None, window=None)
        for name, mount in mounts.items()
    }
    return LensRenderer(make(sources), mounts)


@lru_cache(maxsize=4)
def _lens(camera: PinholeCamera) -> Lens:
    # A map over all pixels: shared by cameras of one make, and by the rollouts of a run.
    return Lens(camera)
