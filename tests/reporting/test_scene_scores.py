"""Lines of the page out of eval.json."""

from __future__ import annotations

from typing import Any

from recast.reporting.inputs import ImageScore
from recast.reporting.tables import MOVING, depth_facts, score_lines


def _frame(moving: object, depth: object, *boxes: str) -> dict[str, Any]:
    return {"boxes": dict.fromkeys(boxes, 20.0), "moving": moving, "depth": depth}


def _evaluation() -> dict[str, Any]:
    depth = {
        "points": 12345,
        "missing": 0.021,
        "median_abs_m": 0.0614,
        "mean_abs_m": 0.52,
        "mean_relative": 0.034,
        "lag_ms": 51.7,
    }
    moving = {"psnr": 21.5, "ssim": 0.7, "lpips": None}
    return {
        "psnr": 24.0,
        "ssim": 0.8,
        "box_psnr_by_track": {"7": 20.0},
        "moving": moving,
        "depth": depth,
        "frames": [_frame(moving, depth, "7"), _frame(None, depth), _frame(None, None, "7")],
    }


def test_what_moves_and_the_depth_have_their_lines() -> None:
    assert score_lines(_evaluation()) == (
        ImageScore("whole image", 24.0, 3, 0.8),
        ImageScore(MOVING, 21.5, 1, 0.7),
        ImageScore("inside the box of track 7", 20.0, 2),
    )
    median, mean, missing = depth_facts(_evaluation())
    assert (median.value, median.help) == ("0.061 m", "2 images")
    assert (mean.value, mean.help) == ("0.52 m", "3.4 % of the distance")
    assert missing.value == "2.1 %" and "12,345 points, measured 52 ms" in str(missing.help)


def test_nothing_moves_and_no_lidar() -> None:
    still = _evaluation() | {"moving": None, "depth": None}
    regions = [line.region for line in score_lines(still)]
    assert regions == ["whole image", "inside the box of track 7"]
    assert depth_facts(still) == ()
