"""The evaluation of a scene as lines and facts of the page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from recast.reporting.inputs import Fact, ImageScore

MOVING = "what moves: boxes, length and width x 1.5"


def score_lines(evaluation: Mapping[str, Any]) -> tuple[ImageScore, ...]:
    """Held-out images: whole, what moves, and inside the box of each track.

    Args:
        evaluation: the contents of eval.json; those of version 1 have no moving pixels.
    """
    frames = evaluation["frames"]
    lines = [ImageScore("whole image", evaluation["psnr"], len(frames), evaluation["ssim"])]
    moving = evaluation.get("moving")
    if moving is not None:
        seen = sum(frame["moving"] is not None for frame in frames)
        lines.append(ImageScore(MOVING, moving["psnr"], seen, moving["ssim"]))
    for track, value in evaluation["box_psnr_by_track"].items():
        seen = sum(track in frame["boxes"] for frame in frames)
        lines.append(ImageScore(f"inside the box of track {track}", value, seen))
    return tuple(lines)


def depth_facts(evaluation: Mapping[str, Any]) -> tuple[Fact, ...]:
    """The scene's depth against the LiDAR; nothing where the log has no sweep at these images.

    Args:
        evaluation: the contents of eval.json; those of version 1 have no depth.
    """
    depth = evaluation.get("depth")
    if depth is None:
        return ()
    seen = sum(frame["depth"] is not None for frame in evaluation["frames"])
    return (
        Fact("Median error", f"{depth['median_abs_m']:.3f} m", f"{seen} images"),
        Fact(
            "Mean error",
            f"{depth['mean_abs_m']:.2f} m",
            f"{100 * depth['mean_relative']:.1f} % of the distance",
        ),
        Fact(
            "No surface",
            f"{100 * depth['missing']:.1f} %",
            f"of {depth['points']:,} points, measured {depth['lag_ms']:.0f} ms from the image",
        ),
    )
