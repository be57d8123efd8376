"""The paper's table 2: scene-level rendering quality of its seven arms."""

from __future__ import annotations

from collections.abc import Mapping

_COLUMNS = (
    "fd_scene", "clip_margin", "vqa_margin", "fd_crop", "clip_img", "clip_veh", "lpips"
)  # fmt: skip

_ROWS = {
    "streetgs": (129.35, 0.14, -294.91, 193.56, 65.43, 20.62, 0.6920),
    "streetgs+TRELLIS": (112.84, 2.86, -172.36, 126.14, 69.54, 21.28, 0.6809),
    "streetgs+AssetHarvester": (110.00, 1.95, -156.42, 124.61, 70.17, 21.03, 0.6818),
    "omnire": (138.52, 0.04, -314.18, 197.41, 65.72, 20.87, 0.6931),
    "omnire+TRELLIS": (121.47, 2.93, -216.82, 133.04, 69.99, 21.32, 0.6824),
    "omnire+AssetHarvester": (119.10, 1.96, -197.11, 129.11, 70.23, 21.11, 0.6823),
    "recast": (112.10, 3.47, -131.04, 124.74, 70.67, 21.43, 0.6800),
}

PUBLISHED: Mapping[str, Mapping[str, float]] = {
    arm: dict(zip(_COLUMNS, values, strict=True)) for arm, values in _ROWS.items()
}
"""Published values by arm and column, on the nine Waymo scenes."""
