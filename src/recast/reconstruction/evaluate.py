"""How well a scene redraws images it was not trained on, and views that the log does not have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from recast.core.errors import InputError
from recast.core.files import atomic_file, write_json
from recast.core.progress import Progress, tell
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.reconstruction.config import SceneConfig
from recast.reconstruction.evaluation import (
    FrameScore,
    SceneEvaluation,
    ShiftedScore,
    ShiftedView,
    ShiftScores,
    Truth,
    ViewShift,
    picture_name,
    shifted_views,
)
from recast.reconstruction.scores import (
    Distance,
    SweepsOfImages,
    capped_psnr,
    depth_score,
    moving_region,
    moving_tracks,
    psnr,
    score_regions,
)
from recast.reconstruction.views import (
    TrainingView,
    camera_names,
    is_held_out,
    read_view,
    visible_rectangle,
)
from recast.scene.render import SceneImage, SceneRasterizer
from recast.scene.street_scene import StreetScene

MIN_BOX_PX = 8
"""Boxes with a shorter edge than this in the image are not scored: too few pixels."""
EVALUATION_FILE = "eval.json"
PICTURED_MOMENTS = 3
"""Held-out moments, spread over the drive, at which shifted views are written as pictures."""


def evaluate_scene(
    scene: StreetScene,
    log: DrivingLog,
    config: SceneConfig,
    out: str | Path | None = None,
    *,
    lpips: Distance | None = None,
    shifts: Sequence[ViewShift] = (),
    truth: Truth | None = None,
    progress: Progress | None = None,
) -> SceneEvaluation:
    """Score the held-out images of a log, and views from beside its drive.

    Args:
        config: the configuration of the training, for cameras, scale and split.
        out: folder for eval.json (no timings: equal runs give equal bytes) and, for each held-out
            image and some shifted ones, a PNG with truth, rendering and three times their
            difference.
        lpips: a distance by networks, scored too.
        shifts: shifts of the ego at the held-out moments.
        truth: what shifted cameras truly see. Without it no shifted view is scored: `out` gets
            pictures of what the scene makes of them.

    Raises:
        InputError: the configuration holds no image out from training.
    """
    chosen = held_out_frames(log, config)
    if not chosen:
        raise InputError(
            "configuration", "holdout_every", "holds no image out", "set it to 8 and train again"
        )
    folder = None if out is None else Path(out)
    pictured = _pictured(log, chosen)
    planned = [shifted_views(log, chosen, config.scale, shift) for shift in shifts]
    if truth is None:
        planned = [[v for v in views if v.timestamp_us in pictured] for views in planned]
    total = len(chosen) + sum(len(views) for views in planned)
    done = iter(range(1, total + 1))
    scorer = ViewScorer(scene, log, lpips)
    scores = {}
    # In order of time: all cameras of a moment share its sweeps.
    for name, frame in sorted(chosen, key=lambda image: _time(log, image)):
        view = read_view(log, log.cameras[name], frame, config.scale, held_out=True)
        rendered = draw_view(scorer.rasterizer, scene, view)
        scores[name, frame] = scorer.held_out(view, rendered)
        if folder is not None:
            write_comparison(folder / picture_name(name, frame), view, rendered.rgb)
        tell(progress, next(done), total)
    found = []
    for shift, views in zip(shifts, planned, strict=True):
        seen = iter(()) if truth is None else truth(views)
        frames, pictures = [], []
        for shifted in views:
            shown = folder is not None and shifted.timestamp_us in pictured
            score = scorer.shifted(shifted, next(seen, None), folder if shown else None)
            frames += [score] if score is not None else []
            pictures += [shifted.picture] if shown else []
            tell(progress, next(done), total)
        found.append(ShiftScores(shift, tuple(frames), tuple(pictures)))
    frames_scored = tuple(scores[image] for image in chosen)
    evaluation = SceneEvaluation(frames_scored, tuple(found), bool(found) and truth is not None)
    if folder is not None:
        write_json(folder / EVALUATION_FILE, evaluation.to_json())
    return evaluation


def held_out_frames(log: DrivingLog, config: SceneConfig) -> list[tuple[str, int]]:
    """Camera and frame of every image that is kept from training."""
    return [
        (name, frame)
        for name in camera_names(log, config)
        for frame in range(len(log.cameras[name].timestamps_us))
        if is_held_out(frame, config)
    ]


def held_out_psnr(scene: StreetScene, views: Sequence[TrainingView]) -> float:
    """Mean PSNR in dB over the usable pixels of views."""
    rasterizer = SceneRasterizer(scene)
    found = []
    for view in views:
        drawn, wanted = draw_view(rasterizer, scene, view).rgb, view.image / 255.0
        usable = slice(None) if view.mask is None else view.mask
        found.append(psnr(drawn[usable], wanted[usable]))
    return float(np.mean(found))


def _time(log: DrivingLog, image: tuple[str, int]) -> int:
    name, frame = image
    return int(log.cameras[name].timestamps_us[frame])


def _pictured(log: DrivingLog, chosen: Sequence[tuple[str, int]]) -> set[int]:
    """Times of `PICTURED_MOMENTS` held-out frames of each camera."""
    times: set[int] = set()
    for name in dict.fromkeys(name for name, _ in chosen):
        frames = [frame for other, frame in chosen if other == name]
        count = min(PICTURED_MOMENTS, len(frames))
        picked = [frames[int((i + 0.5) / count * len(frames))] for i in range(count)]
        times.update(_time(log, (name, frame)) for frame in picked)
    return times


class ViewScorer:
    """Draws and scores views of one scene.

    Args:
        log: log that the views are from.
        lpips: a distance by networks, or None.
    """

    def __init__(self, scene: StreetScene, log: DrivingLog, lpips: Distance | None) -> None:
        self.rasterizer = SceneRasterizer(scene)
        self._scene, self._moving, self._lpips = scene, moving_tracks(log), lpips
        self._sweeps = SweepsOfImages(log, self._moving)

    def held_out(self, view: TrainingView, rendered: SceneImage) -> FrameScore:
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
        view = replace(shifted, image=blank if true is None else true)
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


def draw_view(rasterizer: SceneRasterizer, scene: StreetScene, view: TrainingView) -> SceneImage:
    """A view redrawn: camera corrected, actors where they were; unusable pixels as recorded."""
    pose = scene.corrected_camera(view.camera_from_world, view.camera_name, view.timestamp_us)
    poses = scene.actor_poses(view.timestamp_us)
    time = view.timestamp_us
    image = rasterizer.render(view.camera, pose, poses, colours_us=time, shapes_us=time)
    if view.mask is None:
        return image
    recorded = view.image.astype(np.float32) / 255
    return replace(image, rgb=np.where(view.mask[..., None], image.rgb, recorded))


def _box_psnr(
    scene: StreetScene, view: TrainingView, rendered: NDArray[np.float32]
) -> dict[str, float]:
    recorded = view.image.astype(np.float64) / 255
    found = {}
    for track_id, pose in scene.actor_poses(view.timestamp_us).items():
        rectangle = visible_rectangle(scene.actors[track_id].size, pose, view)
        if rectangle is None:
            continue
        left, top = np.floor(rectangle[:2]).astype(int)
        right, bottom = np.ceil(rectangle[2:]).astype(int)
        if min(right - left, bottom - top) >= MIN_BOX_PX:
            inside = (slice(top, bottom), slice(left, right))
            found[track_id] = capped_psnr(rendered[inside], recorded[inside])
    return found


def write_comparison(path: Path, view: TrainingView, rendered: NDArray[np.float32]) -> None:
    """A PNG with the view's image, what was rendered, and three times their difference."""
    true = view.image.astype(np.float32) / 255
    difference = np.clip(3 * np.abs(rendered - true), 0, 1)
    _write_png(path, np.concatenate([true, rendered, difference], axis=0))


def _write_png(path: Path, image: NDArray[np.float32]) -> None:
    with atomic_file(path) as partial:
        Image.fromarray((image * 255 + 0.5).astype(np.uint8)).save(partial, format="PNG")
