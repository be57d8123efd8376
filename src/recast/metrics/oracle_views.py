"""Baseline and candidate actors against the truth, seen from where the log never was."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PilImage

from recast.actors.coverage import CoverageMeter, Shares
from recast.arrays import Array, Image
from recast.cameras import CameraMount, PinholeCamera
from recast.core.errors import InputError
from recast.core.files import atomic_folder, write_json
from recast.core.progress import Progress, tell
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.metrics.oracle_poses import (
    PlacedView,
    ViewSettings,
    angle_to_nearest,
    azimuth_elevation,
    logged_views,
    place_views,
    view_direction,
)
from recast.metrics.oracle_scores import (
    RECORD_FILE,
    Agreement,
    OracleView,
    OracleViews,
    actor_mask,
    agreement,
    box_pixels,
    grown,
    summarise,
)
from recast.reconstruction.scores import Rectangle
from recast.scene import SceneRasterizer, StreetScene

_MARGIN = 24  # pixels around the box that are ray-traced too: more than half an SSIM window
_OF_PLACE = ("camera", "frame", "timestamp_us", "distance", "heading")
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
        scenes: scenes by arm.
        size: (3,) length, width, height of the vehicle's box, metres.
        mounts: cameras as they are rendered.
        exposures: exposures of the truth's images, by camera; 1 where one is missing.

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
                    f"{arm} scene",
                    f"track {track_id}",
                    "has no model",
                    "train the scene with the track in force_dynamic",
                )
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
        inner = (rectangle[0] - left, rectangle[1] - top, rectangle[2] - left, rectangle[3] - top)
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
        camera_from_world = se3.inverse(view.world_from_camera)
        poses = {self._track_id: view.world_from_actor}
        drawn = self._rasterizers[arm].render(camera, camera_from_world, poses)
        return np.rint(np.clip(drawn.rgb, 0.0, 1.0) * 255).astype(np.uint8)

    def _true(self, camera: PinholeCamera, view: PlacedView) -> OracleFrame:
        return self._oracle.render(
            camera,
            view.world_from_camera,
            {self._track_id: view.world_from_actor},
            timestamp_us=view.timestamp_us,
            exposure=self._exposures.get(view.camera, 1.0),
        )


def evaluate_oracle_views(
    log: DrivingLog,
    baseline: StreetScene,
    candidate: StreetScene,
    oracle: TrueWorld,
    track_id: str,
    mounts: Mapping[str, CameraMount],
    out: str | Path | None = None,
    *,
    rng: np.random.Generator,
    settings: ViewSettings | None = None,
    exposures: Mapping[str, float] | None = None,
    shares: Shares | None = None,
    progress: Progress | None = None,
) -> OracleViews:
    """Compare both actors with the truth where a closed loop may put them.

    The camera stands at logged poses, so that the background is as good as the reconstruction makes
    it; the vehicle stands before it on the road, turned through all headings. PSNR and SSIM are
    those of the image inside the projected box; the mask IoU compares the oracle's visible pixels
    of the vehicle with what the actor, drawn alone, covers by more than half (no shadow).

    Args:
        baseline, candidate: scenes in the log's world frame, with a model of the track.
        oracle: the world that the log was made from.
        mounts: cameras as they are rendered, see `camera_mounts`.
        out: folder to be made, whole or not at all: `oracle_views.json`, `view_000.png`, ... (the
            box and a margin, from left to right baseline, candidate, truth), and the whole images
            `showcase_baseline.png`, `showcase_candidate.png`, `showcase_truth.png` of one view.
        rng: random generator for the intervals.
        settings: settings that say which views are drawn; the default draws 36.
        exposures: exposures of the log's images, by camera; the truth's images are given them too.
            1 if missing.
        shares: shares of the candidate actor that were seen, mirrored and invented, if they are
            known; each view then tells them for what it shows.
        progress: called with the number of views done, and of all.

    Raises:
        InputError: the log or a scene has no such track, no logged image shows it, or there is no
            place for it on the recorded road; `out` exists.
    """
    if track_id not in log.tracks:
        raise InputError(
            log.name,
            f"track {track_id}",
            "is not in the log",
            f"choose one of {', '.join(log.tracks)}",
        )
    settings = ViewSettings() if settings is None else settings
    track = log.tracks[track_id]
    logged = logged_views(log, track)
    if len(logged) == 0:
        raise InputError(
            log.name, f"track {track_id}", "is not in any image of the log", "choose another track"
        )
    painter = Painter(
        {"baseline": baseline, "candidate": candidate},
        oracle,
        track_id,
        track.size,
        mounts,
        exposures or {},
    )
    placed = [
        (view, rectangle)
        for view in place_views(log, track, mounts, settings)
        if (rectangle := painter.rectangle(view)) is not None
    ]
    if not placed:
        raise InputError(
            log.name,
            f"track {track_id}",
            "is not visible at any of the distances ahead of the ego",
            "give other distances",
        )
    meter = None if shares is None else CoverageMeter(candidate, track_id, shares)
    with nullcontext() if out is None else atomic_folder(out) as folder:
        views = []
        for index, (view, rectangle) in enumerate(placed):
            direction = view_direction(view.world_from_actor, view.world_from_camera)
            scores, picture = painter.compare(view, rectangle)
            azimuth, elevation = azimuth_elevation(direction)
            views.append(
                OracleView(
                    index=index,
                    **{name: getattr(view, name) for name in _OF_PLACE},
                    azimuth=azimuth,
                    elevation=elevation,
                    angle=angle_to_nearest(direction, logged),
                    rectangle=rectangle,
                    baseline=scores["baseline"],
                    candidate=scores["candidate"],
                    coverage=None
                    if meter is None
                    else meter.measure(
                        mounts[view.camera].camera,
                        se3.inverse(view.world_from_camera),
                        {track_id: view.world_from_actor},
                    ),
                )
            )
            if folder is not None:
                _save(folder / views[-1].picture, picture)
            tell(progress, index + 1, len(placed))
        result = OracleViews(
            track_id, len(logged), tuple(views), summarise(views, rng), _furthest(views)
        )
        if folder is not None:
            for side, image in painter.whole(placed[result.showcase][0]).items():
                _save(folder / f"showcase_{side}.png", image)
            write_json(folder / RECORD_FILE, result.to_json())
    return result


def _furthest(views: list[OracleView]) -> int:
    nearest = min(view.distance for view in views)
    near = [view for view in views if view.distance < nearest + 0.01]
    return max(near, key=lambda view: (round(view.angle, 3), -view.index)).index


def _save(path: Path, image: NDArray[np.uint8]) -> None:
    PilImage.fromarray(image).save(path, format="PNG")
