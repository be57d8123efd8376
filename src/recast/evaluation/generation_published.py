"""The figures of the RECAST paper for actor-level generation (section 5, Q3), to set beside ours.

They are of its held-out RECAR vehicles and the published weights; on another set they say what to
expect of the order, not of the values.
"""

from __future__ import annotations

from collections.abc import Mapping

PAPER_COLUMNS = ("psnr", "ssim", "lpips", "clip", "fd_inception", "fd_dino")
"""Scores in the paper's order, keys of `STUDY_COLUMNS`."""

PAPER_ROWS: Mapping[str, tuple[float, ...]] = {
    "Real3D": (13.19, 0.5691, 0.3223, 68.17, 91.196, 1282.01),
    "LN3Diff": (18.95, 0.8843, 0.1105, 63.03, 93.288, 1455.05),
    "3DTopia-XL": (15.54, 0.8085, 0.1817, 59.90, 166.294, 1299.59),
    "SAR3D": (15.39, 0.8231, 0.1588, 66.55, 64.042, 746.99),
    "Asset Harvester": (19.22, 0.8792, 0.1044, 78.29, 38.368, 183.08),
    "TRELLIS": (21.02, 0.9077, 0.0603, 78.22, 9.788, 43.89),
    "Stage I only": (22.90, 0.9178, 0.0534, 78.30, 8.176, 36.94),
    "both stages": (22.90, 0.9179, 0.0532, 78.38, 7.992, 36.47),
}
"""Scores by name of the row, in the order of `PAPER_COLUMNS`. The last three are the ablation."""


def published(row: str) -> dict[str, float]:
    """Scores of a row of the paper, by key of `STUDY_COLUMNS`."""
    return dict(zip(PAPER_COLUMNS, PAPER_ROWS[row], strict=True))
