"""Rows of `recast scene eval`."""

from __future__ import annotations

from typing import Any

from recast.cli.output import Rows
from recast.scene import RegionScore, SceneEvaluation


def evaluation_rows(evaluation: SceneEvaluation) -> Rows:
    """Scores of held-out images by region, of the depth, and of novel views by shift.

    A shift without ground truth has no scores.
    """
    frames = evaluation.frames
    regions = [_region("whole image", len(frames), evaluation.whole)]
    if evaluation.moving is not None:
        seen = sum(frame.moving is not None for frame in frames)
        regions.append(_region("moving objects", seen, evaluation.moving))
    for track, psnr in evaluation.box_psnr_by_track().items():
        seen = sum(track in frame.boxes for frame in frames)
        regions.append({"region": "box", "track_id": track, "images": seen, "psnr_db": psnr})
    if evaluation.box_psnr is not None:
        seen = sum(bool(frame.boxes) for frame in frames)
        regions.append({"region": "all boxes", "images": seen, "psnr_db": evaluation.box_psnr})
    depth = evaluation.depth
    shifts = [
        {
            **_region("whole image", len(one.frames), one.whole),
            "shift": one.shift.name,
            "pictures": one.pictures,
        }
        for one in evaluation.shifts
    ]
    return {
        "held_out_images": regions,
        "depth": [] if depth is None else [_depth(depth)],
        "novel_views": shifts,
    }


def _region(name: str, images: int, score: RegionScore | None) -> dict[str, Any]:
    return {
        "region": name,
        "images": images,
        "psnr_db": None if score is None else score.psnr,
        "ssim": None if score is None else score.ssim,
        "lpips": None if score is None else score.lpips,
    }


def _depth(depth: Any) -> dict[str, Any]:
    return {
        "lidar_points": depth.points,
        "missing_percent": 100 * depth.missing,
        "median_error_m": depth.median_abs_m,
        "mean_error_m": depth.mean_abs_m,
        "mean_relative_error_percent": 100 * depth.mean_relative,
        "lag_ms": depth.lag_ms,
    }
