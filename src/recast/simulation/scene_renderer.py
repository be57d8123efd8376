"""The sensor renderer over a reconstructed street scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from recast.errors import InputError
from recast.geometry import se3
from recast.planning import CameraMount
from recast.scene.render import SceneRasterizer
from recast.scene.street_scene import StreetScene
from recast.simulation.state import SimState

Image = NDArray[np.uint8]


class SceneRenderer:
    """Renders a reconstructed street scene.

    Args:
        scene: in the log's world frame; must hold the controlled actors.
        mounts: cameras to render, see `camera_mounts`.
        device: where to render, see `SceneRasterizer`.
    """

    def __init__(
        self,
        scene: StreetScene,
        mounts: Mapping[str, CameraMount],
        device: str = "auto",
    ) -> None:
        self.scene = scene
        self._rasterizer = SceneRasterizer(scene, device)
        self._mounts = dict(mounts)

    @property
    def mounts(self) -> Mapping[str, CameraMount]:
        """Cameras by name."""
        return self._mounts

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Render the scene with its actors at the poses of `state`.

        Raises:
            InputError: the scene has no model of a controlled actor.
        """
        for track_id in state.actors:
            if track_id not in self.scene.actors:
                there = ", ".join(self.scene.actors) or "none"
                raise InputError(
                    "scene",
                    f"actor {track_id}",
                    "has no model in the scene",
                    f"it has {there}; reconstruct or insert it first",
                )
        # Other tracks that the scene modelled as background cannot be moved or drawn apart.
        poses = {key: pose for key, pose in state.poses.items() if key in self.scene.actors}
        images = {}
        for name in camera_names:
            mount = self._mounts[name]
            camera_from_world = se3.inverse(state.world_from_rig @ mount.rig_from_camera)
            drawn = self._rasterizer.draw(
                mount.camera, camera_from_world, poses, shapes_us=state.timestamp_us
            )
            # Quantised where it was drawn: a quarter of the bytes to bring over.
            images[name] = (drawn.rgb * 255).round().to(torch.uint8).cpu().numpy()
        return images
