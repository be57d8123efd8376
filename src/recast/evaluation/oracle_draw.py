"""The same view drawn from reconstructions and from the truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.evaluation.oracle_poses import PlacedView
from recast.evaluation.oracle_scores import (
    Agreement,
    Rectangle,
    actor_mask,
    agreement,
    box_pixels,
    grown,
)
from recast.geometry import PinholeCamera, se3
from recast.planning import CameraMount
from recast.scene import SceneRasterizer, StreetScene

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_MARGIN = 24  # pixels around the box that are ray-traced too: more than half an SSIM window
_GAP = 4  # white pixels between pictures


class OracleFrame(Protocol):
    """The truth's picture: (H, W, 3) uint8 RGB, and (H, W) which object each pixel shows."""

    @property
    def rgb(self) -> Image:
        """(H, W, 3) uint8."""

    @property
    def instance(self) -> NDArray[np.uint16]:
        """(H, W)."""


class TrueWorld(Protocol):
    """A world that can be looked at from anywhere."""

    def render(
        self,
        camera: PinholeCamera,
        world_from_camera: Array,
        poses: Mapping[str, Array],
        timestamp_us: int,
        exposure: float,
    ) -> OracleFrame:
        """The street, and the vehicles of `poses` (`world_from_actor` (4, 4) by track id)."""

    def instance_of(self, track_id: str) -> int:
        """The value of `OracleFrame.instance` where it shows this vehicle."""


class Painter:
    """Draws a view with both actors and by the oracle.

    Args:
        scenes: by arm.
        size: (3,) of the vehicle's box.
        mounts: cameras as they are rendered.
        exposures: of the truth's images, by camera; 1 where one is missing.

    Raises:
        InputError: a scene has no model of the track.
    """

    def __init__(
        self,
        scenes: Mapping[str, StreetScene],
        oracle: TrueWorld,
        track_id: str,
        size: Array,
        mounts: Mapping[str, CameraMount],
        exposures: Mapping[str, float],
    ) -> None:
        for arm, scene in scenes.items():
            if track_id not in scene.actors:
                raise InputError(
                    f"{arm} scene", f"track {track_id}", "has no model",
                    "train the scene with the track in force_dynamic",
                )  # fmt: skip
        self._actors = {arm: scene.actors[track_id] for arm, scene in scenes.items()}
        self._rasterizers = {arm: SceneRasterizer(scene) for arm, scene in scenes.items()}
        self._oracle, self._track_id, self._size = oracle, track_id, size
        self._mounts, self._exposures = mounts, exposures

    def rectangle(self, view: PlacedView) -> Rectangle | None:
        """Where the vehicle's box is in the image; see `box_pixels`."""
        camera_from_actor = se3.inverse(view.world_from_camera) @ view.world_from_actor
        return box_pixels(self._size, camera_from_actor, self._mounts[view.camera].camera)

    def compare(self, view: PlacedView, rectangle: Rectangle) -> tuple[dict[str, Agreement], Image]:
        """Scores by arm, and the pictures of the box side by side."""
        camera = self._mounts[view.camera].camera
        left, top, right, bottom = grown(rectangle, _MARGIN, camera.width, camera.height)
        # Only the box and a margin are ray-traced: the whole image would take three times as long.
        truth = self._true(camera.cropped(left, top, right - left, bottom - top), view)
        window = (slice(top, bottom), slice(left, right))
        true_mask = np.zeros((camera.height, camera.width), np.bool_)
        true_mask[window] = truth.instance == self._oracle.instance_of(self._track_id)
        inner = (
            rectangle[0] - left, rectangle[1] - top, rectangle[2] - left, rectangle[3] - top
        )  # fmt: skip
        camera_from_world = se3.inverse(view.world_from_camera)
        scores, pictures = {}, []
        for arm, actor in self._actors.items():
            image = self._drawn(arm, camera, view)[window]
            mask = actor_mask(actor, camera, camera_from_world, view.world_from_actor)
            scores[arm] = agreement(image, truth.rgb, inner, mask, true_mask)
            pictures.append(image)
        gap = np.full((bottom - top, _GAP, 3), 255, np.uint8)
        return scores, np.concatenate([pictures[0], gap, pictures[1], gap, truth.rgb], axis=1)

    def whole(self, view: PlacedView) -> dict[str, Image]:
        """Whole images: by arm, then "truth"."""
        camera = self._mounts[view.camera].camera
        images = {arm: self._drawn(arm, camera, view) for arm in self._actors}
        return {**images, "truth": self._true(camera, view).rgb}

    def _drawn(self, arm: str, camera: PinholeCamera, view: PlacedView) -> Image:
        rgb = (
            self._rasterizers[arm]
            .render(
                camera,
                se3.inverse(view.world_from_camera),
                {self._track_id: view.world_from_actor},
            )
            .rgb
        )
        image: Image = np.rint(np.clip(rgb, 0.0, 1.0) * 255).astype(np.uint8)
        return image

    def _true(self, camera: PinholeCamera, view: PlacedView) -> OracleFrame:
        return self._oracle.render(
            camera,
            view.world_from_camera,
            {self._track_id: view.world_from_actor},
            timestamp_us=view.timestamp_us,
            exposure=self._exposures.get(view.camera, 1.0),
        )
