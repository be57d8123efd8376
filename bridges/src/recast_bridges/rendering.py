"""Scenes as a renderer for others: cameras and poses that a request names, drawn at mid-frame."""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from threading import Lock
from typing import Literal

import numpy as np

from recast.arrays import Array, Image
from recast.cameras import CameraMount, Lens, PinholeCamera
from recast.geometry import se3
from recast.scene.street_scene import SceneRasterizer, StreetScene
from recast.simulation.scene_renderer import draw_image
from recast_bridges.requests import MOST_IN_ALL, AnyCamera, RefusedError, RenderRequest

_LOG = logging.getLogger(__name__)

Unnamed = Literal["hidden", "logged"]
"""What becomes of moving actors that a request does not name: not drawn, or drawn where the log has
them at mid-frame. Parked ones stand where they are."""

_FACES = 8
"""Pixels of the pinhole images that one pixel of a lens may need, at most."""
_LEAST = 1 << 16


@dataclass(frozen=True)
class ServedScene:
    """A scene under the name that others call it by.

    Attributes:
        scene: scene in the log's world frame.
        cameras: cameras of the rig by name, as `get_available_cameras` lists them.
        world_from_local: (4, 4) rigid; the frame of all poses on the wire is local.
        start_us: log time of the first ego pose.
    """

    scene: StreetScene
    cameras: Mapping[str, CameraMount]
    world_from_local: Array = field(default_factory=lambda: np.eye(4))
    start_us: int = 0


class ScenePainter:
    """Draws what requests ask for. It keeps nothing of a request but the maps of its lens.

    Safe to use from many threads: one draws at a time.

    Args:
        scenes: scenes by id.
        device: device to draw on, see `SceneRasterizer`.
        unnamed: see `Unnamed`.
    """

    def __init__(
        self, scenes: Mapping[str, ServedScene], device: str = "auto", unnamed: Unnamed = "hidden"
    ) -> None:
        self.scenes, self._unnamed = dict(scenes), unnamed
        self._rasterizers = {k: SceneRasterizer(s.scene, device) for k, s in self.scenes.items()}
        self._lenses, self._lock = _Lenses(), Lock()
        self._told: set[tuple[str, str]] = set()

    def scene(self, scene_id: str) -> ServedScene:
        """A scene by its id. Raises RefusedError: NOT_FOUND."""
        if scene_id not in self.scenes:
            known = ", ".join(self.scenes)
            raise RefusedError("NOT_FOUND", f"scene_id: {scene_id[:100]!r} is not one of {known}")
        return self.scenes[scene_id]

    def draw(self, request: RenderRequest, wanted: Callable[[], bool] = lambda: True) -> Image:
        """The image (height, width, 3) uint8 RGB.

        Args:
            wanted: asked before drawing, which may have to wait for its turn.

        Raises:
            RefusedError: NOT_FOUND for the scene; INVALID_ARGUMENT for a lens that would need far
                more pixels than the image has; CANCELLED if it is no longer wanted.
        """
        served = self.scene(request.scene_id)
        world = served.world_from_local
        poses = {k: world @ pose for k, pose in request.poses.items() if self._has(request, k)}
        if self._unnamed == "logged":
            poses = {**served.scene.actor_poses(request.timestamp_us), **poses}
        camera_from_world = se3.inverse(world @ request.local_from_camera)
        camera, rasterizer = request.camera, self._rasterizers[request.scene_id]
        # A new lens is measured before others have to wait.
        lens = None
        if isinstance(camera, PinholeCamera) and camera.is_rectified:
            views = [(camera, camera_from_world)]
        else:
            lens = self._lenses.of(camera)
            turns = [
                se3.from_rotation_translation(f.face_from_lens, np.zeros(3)) for f in lens.faces
            ]
            views = [
                (f.camera, t @ camera_from_world) for f, t in zip(lens.faces, turns, strict=True)
            ]
        with self._lock:
            if not wanted():
                raise RefusedError("CANCELLED", "the caller has disconnected")
            images = [
                draw_image(rasterizer, pinhole, pose, poses, request.timestamp_us)
                for pinhole, pose in views
            ]
        return images[0] if lens is None else lens.bend(*images)

    def _has(self, request: RenderRequest, track_id: str) -> bool:
        """Whether a track has a model; one without is part of the background, and told of once."""
        if track_id in self.scenes[request.scene_id].scene.actors:
            return True
        told = request.scene_id, track_id
        if told not in self._told and len(self._told) < 10_000:
            self._told.add(told)
            _LOG.warning("scene %s has no model of track %r: the track is not rendered", *told)
        return False


class _Lenses:
    """The last used lenses, within a number of pixels: their maps are large."""

    def __init__(self) -> None:
        self._kept: OrderedDict[AnyCamera, Lens] = OrderedDict()
        self._lock = Lock()

    def of(self, camera: AnyCamera) -> Lens:
        with self._lock:
            if camera not in self._kept:
                pixels = camera.width * camera.height
                try:
                    self._kept[camera] = Lens(camera, _FACES * pixels + _LEAST)
                except ValueError as error:
                    raise RefusedError("INVALID_ARGUMENT", f"camera_intrinsics: {error}") from None
            self._kept.move_to_end(camera)
            lens = self._kept[camera]
            while sum(kept.width * kept.height for kept in self._kept) > MOST_IN_ALL:
                self._kept.popitem(last=False)
            return lens
