"""How well a scene redraws images it was not trained on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from recast.errors import InputError
from recast.logs import DrivingLog
from recast.scene.config import SceneConfig
from recast.scene.dynamic import box_rectangle
from recast.scene.image_metrics import psnr, ssim
from recast.scene.render import SceneRasterizer
from recast.scene.street_scene import StreetScene
from recast.scene.views import View, camera_names, is_held_out, read_view
from recast.storage import atomic_file, write_json

EVALUATION_VERSION = 1
MIN_BOX_PX = 8
"""Boxes with a shorter edge than this in the image are not scored: too few pixels."""


@dataclass(frozen=True)
class FrameScore:
    """Scores of one held-out image.

    Attributes:
        camera, frame, timestamp_us: which image.
        psnr, ssim: of the whole image.
        boxes: PSNR in dB inside the rectangle around each visible actor's projected box.
    """

    camera: str
    frame: int
    timestamp_us: int
    psnr: float
    ssim: float
    boxes: Mapping[str, float]


@dataclass(frozen=True)
class SceneEvaluation:
    """Scores of all held-out images; means are over images, and over (image, actor) for boxes."""

    frames: tuple[FrameScore, ...]

    @property
    def psnr(self) -> float:
        """Mean PSNR in dB."""
        return float(np.mean([frame.psnr for frame in self.frames]))

    @property
    def ssim(self) -> float:
        """Mean SSIM."""
        return float(np.mean([frame.ssim for frame in self.frames]))

    @property
    def box_psnr(self) -> float | None:
        """Mean PSNR in dB inside the actors' boxes; None where no actor is seen."""
        values = [value for frame in self.frames for value in frame.boxes.values()]
        return float(np.mean(values)) if values else None

    def box_psnr_by_track(self) -> dict[str, float]:
        """Mean PSNR in dB inside each actor's box."""
        tracks = sorted({track for frame in self.frames for track in frame.boxes})
        return {
            track: float(np.mean([f.boxes[track] for f in self.frames if track in f.boxes]))
            for track in tracks
        }


def evaluate_scene(
    scene: StreetScene, log: DrivingLog, config: SceneConfig, out: str | Path | None = None
) -> SceneEvaluation:
    """Score the held-out images of a log; optionally write eval.json and pictures.

    Args:
        config: the configuration of the training, for cameras, scale and split.
        out: folder for eval.json (no timings: equal runs give equal bytes) and, for each image, a
            PNG with recording, rendering and three times their difference.

    Raises:
        InputError: the configuration keeps no image from training.
    """
    names = camera_names(log, config)
    chosen = [
        (name, frame)
        for name in names
        for frame in range(len(log.cameras[name].timestamps_us))
        if is_held_out(frame, config)
    ]
    if not chosen:
        raise InputError(
            "configuration", "holdout_every", "keeps no image", "set it to 8 and train again"
        )
    rasterizer = SceneRasterizer(scene)
    scores = []
    for name, frame in chosen:
        view = read_view(log, log.cameras[name], frame, config.scale, held_out=True)
        rendered = draw_view(rasterizer, scene, view)
        scores.append(score_view(scene, view, rendered))
        if out is not None:
            _write_picture(Path(out) / f"{name}_{frame:06d}.png", view, rendered)
    evaluation = SceneEvaluation(tuple(scores))
    if out is not None:
        write_json(Path(out) / "eval.json", _record(evaluation))
    return evaluation


def held_out_psnr(scene: StreetScene, views: Sequence[View]) -> float:
    """Mean PSNR in dB over views."""
    rasterizer = SceneRasterizer(scene)
    return float(np.mean([psnr(draw_view(rasterizer, scene, v), v.image / 255.0) for v in views]))


def draw_view(rasterizer: SceneRasterizer, scene: StreetScene, view: View) -> NDArray[np.float32]:
    """A log view redrawn: camera corrected, actors where they were; unusable pixels as recorded."""
    pose = scene.corrected_camera(view.camera_from_world, view.camera_name, view.timestamp_us)
    rgb = rasterizer.render(view.camera, pose, scene.actor_poses(view.timestamp_us)).rgb
    if view.mask is not None:
        rgb = np.where(view.mask[..., None], rgb, view.image.astype(np.float32) / 255)
    return rgb


def score_view(scene: StreetScene, view: View, rendered: NDArray[np.float32]) -> FrameScore:
    """PSNR and SSIM of a redrawn view, and PSNR inside the actors' rectangles."""
    recorded = view.image.astype(np.float64) / 255
    boxes = {}
    for track_id, pose in scene.actor_poses(view.timestamp_us).items():
        rectangle = box_rectangle(scene.actors[track_id].size, pose, view)
        if rectangle is None:
            continue
        left, top = np.floor(rectangle[:2]).astype(int)
        right, bottom = np.ceil(rectangle[2:]).astype(int)
        if min(right - left, bottom - top) >= MIN_BOX_PX:
            inside = (slice(top, bottom), slice(left, right))
            boxes[track_id] = psnr(rendered[inside], recorded[inside])
    return FrameScore(
        camera=view.camera_name,
        frame=view.frame,
        timestamp_us=view.timestamp_us,
        psnr=psnr(rendered, recorded),
        ssim=ssim(rendered, recorded),
        boxes=boxes,
    )


def _record(evaluation: SceneEvaluation) -> dict[str, Any]:
    return {
        "version": EVALUATION_VERSION,
        "psnr": evaluation.psnr,
        "ssim": evaluation.ssim,
        "box_psnr": evaluation.box_psnr,
        "box_psnr_by_track": evaluation.box_psnr_by_track(),
        "frames": [
            {
                "camera": frame.camera,
                "frame": frame.frame,
                "timestamp_us": frame.timestamp_us,
                "psnr": frame.psnr,
                "ssim": frame.ssim,
                "boxes": dict(frame.boxes),
            }
            for frame in evaluation.frames
        ],
    }


def _write_picture(path: Path, view: View, rendered: NDArray[np.float32]) -> None:
    recorded = view.image.astype(np.float32) / 255
    difference = np.clip(3 * np.abs(rendered - recorded), 0, 1)
    stack = np.concatenate([recorded, rendered, difference], axis=0)
    with atomic_file(path) as partial:
        Image.fromarray((stack * 255 + 0.5).astype(np.uint8)).save(partial, format="PNG")
