"""One view of a scene redrawn, scored, and written as a picture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from recast.geometry import se3
from recast.logs import DrivingLog
from recast.scene.dynamic import box_rectangle
from recast.scene.evaluate_depth import NearestSweeps, depth_score
from recast.scene.evaluate_record import FrameScore
from recast.scene.evaluate_regions import (
    Distance,
    capped_psnr,
    moving_region,
    moving_tracks,
    score_regions,
)
from recast.scene.evaluate_shifts import ShiftedScore, ShiftedView
from recast.scene.render import SceneImage, SceneRasterizer
from recast.scene.street_scene import StreetScene
from recast.scene.views import View
from recast.storage import atomic_file

MIN_BOX_PX = 8
"""Boxes with a shorter edge than this in the image are not scored: too few pixels."""


class ViewJudge:
    """Draws and scores views of one scene.

    Args:
        log: of the views.
        lpips: a distance by networks, or None.
    """

    def __init__(self, scene: StreetScene, log: DrivingLog, lpips: Distance | None) -> None:
        self.rasterizer = SceneRasterizer(scene)
        self._scene, self._moving, self._lpips = scene, moving_tracks(log), lpips
        self._sweeps = NearestSweeps(log, self._moving)

    def held_out(self, view: View, rendered: SceneImage) -> FrameScore:
        """Score a held-out image against its recording and the LiDAR of its moment.

        Sweeps are read once where images come in order of time.
        """
        scene, time = self._scene, view.timestamp_us
        region = moving_region(self._moving, view)
        whole, moving = score_regions(rendered.rgb, view, region, self._lpips)
        # The laser's points are looked at from where the image was drawn from.
        pose = scene.corrected_camera(view.camera_from_world, view.camera_name, time)
        drawn_from = replace(view, world_from_camera=se3.inverse(pose))
        return FrameScore(
            camera=view.camera_name,
            frame=view.frame,
            timestamp_us=time,
            whole=whole,
            boxes=_box_psnr(scene, view, rendered.rgb),
            moving=moving,
            depth=depth_score(rendered, drawn_from, self._sweeps.at(time), self._moving),
        )

    def shifted(
        self, shifted: ShiftedView, true: NDArray[np.uint8] | None, folder: Path | None
    ) -> ShiftedScore | None:
        """Score a view where its truth is known; with a folder, write its picture."""
        camera = shifted.camera
        blank = np.zeros((camera.height, camera.width, 3), np.uint8)
        view = shifted.seen_as(blank if true is None else true)
        rgb = draw_view(self.rasterizer, self._scene, view).rgb
        if true is None:
            if folder is not None:
                _write_png(folder / shifted.picture, rgb)
            return None
        if folder is not None:
            write_comparison(folder / shifted.picture, view, rgb)
        region = moving_region(self._moving, view)
        whole, moving = score_regions(rgb, view, region, self._lpips)
        return ShiftedScore(view.camera_name, view.frame, view.timestamp_us, whole, moving)


def draw_view(rasterizer: SceneRasterizer, scene: StreetScene, view: View) -> SceneImage:
    """A view redrawn: camera corrected, actors where they were; unusable pixels as recorded."""
    pose = scene.corrected_camera(view.camera_from_world, view.camera_name, view.timestamp_us)
    poses = scene.actor_poses(view.timestamp_us)
    time = view.timestamp_us
    image = rasterizer.render(view.camera, pose, poses, colours_us=time, shapes_us=time)
    if view.mask is None:
        return image
    recorded = view.image.astype(np.float32) / 255
    return replace(image, rgb=np.where(view.mask[..., None], image.rgb, recorded))


def _box_psnr(scene: StreetScene, view: View, rendered: NDArray[np.float32]) -> dict[str, float]:
    recorded = view.image.astype(np.float64) / 255
    found = {}
    for track_id, pose in scene.actor_poses(view.timestamp_us).items():
        rectangle = box_rectangle(scene.actors[track_id].size, pose, view)
        if rectangle is None:
            continue
        left, top = np.floor(rectangle[:2]).astype(int)
        right, bottom = np.ceil(rectangle[2:]).astype(int)
        if min(right - left, bottom - top) >= MIN_BOX_PX:
            inside = (slice(top, bottom), slice(left, right))
            found[track_id] = capped_psnr(rendered[inside], recorded[inside])
    return found


def write_comparison(path: Path, view: View, rendered: NDArray[np.float32]) -> None:
    """A PNG with the view's image, what was rendered, and three times their difference."""
    true = view.image.astype(np.float32) / 255
    difference = np.clip(3 * np.abs(rendered - true), 0, 1)
    _write_png(path, np.concatenate([true, rendered, difference], axis=0))


def _write_png(path: Path, image: NDArray[np.float32]) -> None:
    with atomic_file(path) as partial:
        Image.fromarray((image * 255 + 0.5).astype(np.uint8)).save(partial, format="PNG")
