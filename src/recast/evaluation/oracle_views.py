"""Baseline and candidate actors against the truth, seen from where the log never was."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PilImage

from recast.actors.coverage import CoverageMeter
from recast.actors.shares import Shares
from recast.errors import InputError
from recast.evaluation.oracle_directions import (
    angle_to_nearest,
    azimuth_elevation,
    logged_views,
    view_direction,
)
from recast.evaluation.oracle_draw import Painter, TrueWorld
from recast.evaluation.oracle_poses import ViewSettings, place_views
from recast.evaluation.oracle_record import RECORD_FILE, OracleView, OracleViews
from recast.evaluation.oracle_summary import summarise
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.planning import CameraMount
from recast.scene import StreetScene
from recast.storage import atomic_folder, write_json


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
    progress: Callable[[int, int], None] | None = None,
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
        rng: for the intervals.
        settings: which views; the default draws 36.
        exposures: of the log's images, by camera, which the truth's are given too; 1 if missing.
        shares: shares of the candidate actor that were seen, mirrored and invented, if they are
            known; each view then tells them for what it shows.
        progress: told the number of views done, and of all.

    Raises:
        InputError: the log or a scene has no such track, no logged image shows it, or there is no
            place for it on the recorded road; `out` exists.
    """
    if track_id not in log.tracks:
        raise InputError(
            log.name, f"track {track_id}", "is not in the log", f"choose of {', '.join(log.tracks)}"
        )
    settings = ViewSettings() if settings is None else settings
    track = log.tracks[track_id]
    logged = logged_views(log, track)
    if len(logged) == 0:
        raise InputError(
            log.name, f"track {track_id}", "is in no image of the log", "choose another track"
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
            log.name, f"track {track_id}", "is in view at none of the places before the ego",
            "ask for other distances",
        )  # fmt: skip
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
                    camera=view.camera,
                    frame=view.frame,
                    timestamp_us=view.timestamp_us,
                    distance=view.distance,
                    heading=view.heading,
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
            if progress is not None:
                progress(index + 1, len(placed))
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
