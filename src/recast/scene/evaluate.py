"""How well a scene redraws images it was not trained on, and views that the log does not have."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.logs import DrivingLog
from recast.scene.config import SceneConfig
from recast.scene.evaluate_record import SceneEvaluation
from recast.scene.evaluate_regions import Distance
from recast.scene.evaluate_shifts import (
    ShiftScores,
    Truth,
    ViewShift,
    picture_name,
    shifted_views,
)
from recast.scene.evaluate_views import ViewJudge, draw_view, write_comparison
from recast.scene.image_metrics import psnr
from recast.scene.render import SceneRasterizer
from recast.scene.street_scene import StreetScene
from recast.scene.views import View, camera_names, is_held_out, read_view
from recast.storage import write_json

EVALUATION_FILE = "eval.json"
PICTURED_MOMENTS = 3
"""Held-out moments, spread over the drive, at which shifted views are written as pictures."""

Progress = Callable[[int, int], None]
"""Called with how many views are scored, and how many there will be."""


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
        shifts: of the ego at the held-out moments.
        truth: what shifted cameras truly see. Without it no shifted view is scored: `out` gets
            pictures of what the scene makes of them.

    Raises:
        InputError: the configuration keeps no image from training.
    """
    chosen = held_out_frames(log, config)
    if not chosen:
        raise InputError(
            "configuration", "holdout_every", "keeps no image", "set it to 8 and train again"
        )
    folder = None if out is None else Path(out)
    pictured = _pictured(log, chosen)
    planned = [shifted_views(log, chosen, config.scale, shift) for shift in shifts]
    if truth is None:
        planned = [[v for v in views if v.timestamp_us in pictured] for views in planned]
    total, done = len(chosen) + sum(len(views) for views in planned), 0

    def tell() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total)

    judge = ViewJudge(scene, log, lpips)
    scores = {}
    # In order of time: all cameras of a moment share its sweeps.
    for name, frame in sorted(chosen, key=lambda image: _time(log, image)):
        view = read_view(log, log.cameras[name], frame, config.scale, held_out=True)
        rendered = draw_view(judge.rasterizer, scene, view)
        scores[name, frame] = judge.held_out(view, rendered)
        if folder is not None:
            write_comparison(folder / picture_name(name, frame), view, rendered.rgb)
        tell()
    found = []
    for shift, views in zip(shifts, planned, strict=True):
        seen = iter(()) if truth is None else truth(views)
        frames, pictures = [], []
        for shifted in views:
            shown = folder is not None and shifted.timestamp_us in pictured
            score = judge.shifted(shifted, next(seen, None), folder if shown else None)
            frames += [score] if score is not None else []
            pictures += [shifted.picture] if shown else []
            tell()
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


def held_out_psnr(scene: StreetScene, views: Sequence[View]) -> float:
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
