"""The files of a scene-level evaluation: scene_level.parquet, results.json and table.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from recast.core.table_files import write_parquet
from recast.metrics.scene_level.scores import COLUMNS, IMAGE_SCORES, image_scores
from recast.metrics.scene_level.summary import LevelRow, MeasuredScene, Value
from recast.metrics.table import rounded

_COLUMNS = ("fd_scene", "clip_margin", "vqa_margin", "fd_crop", "clip_img", "clip_veh", "lpips")
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
_RECTANGLE = ("left", "top", "right", "bottom")
SCHEMA = pa.schema(
    [
        *((name, pa.string()) for name in ("arm", "scene", "motion", "setting")),
        ("step", pa.int64()),
        ("camera", pa.string()),
        *((name, pa.int64()) for name in _RECTANGLE),
        ("drawn", pa.bool_()),
        *((name, pa.float64()) for name in IMAGE_SCORES),
    ]
)
"""Columns of scene_level.parquet; scores without weights, and of images not drawn, are null."""


def write_images(scenes: Mapping[str, MeasuredScene], path: Path) -> None:
    """Write a row for each image of each arm, whole or not at all."""
    rows: list[dict[str, Any]] = []
    for name, scene in scenes.items():
        for arm, features in scene.arms.items():
            scores = image_scores(features, scene.references, np.array(scene.compared, np.int64))
            for index, frame in enumerate(scene.frames):
                rows.append(
                    {
                        "arm": arm,
                        "scene": name,
                        **vars(frame),
                        **dict(zip(_RECTANGLE, frame.rectangle, strict=True)),
                        "drawn": bool(features["drawn"][index]),
                        **{key: _number(values[index]) for key, values in scores.items()},
                    }
                )
    write_parquet(path, pa.Table.from_pylist(rows, schema=SCHEMA))


def results_json(
    rows: Sequence[LevelRow],
    scenes: Mapping[str, MeasuredScene],
    failures: Mapping[str, str],
    record: Mapping[str, Any],
) -> dict[str, Any]:
    """Plain data; the same evaluation gives the same bytes.

    Args:
        failures: what does not count, and why.
        record: description of the evaluation, see `LevelSettings.record`.
    """
    return rounded(
        {
            **record,
            "columns": {name: vars(column) for name, column in COLUMNS.items()},
            "table": [
                {
                    "arm": row.arm,
                    "images": row.images,
                    "values": {name: vars(one) for name, one in row.values.items()},
                }
                for row in rows
            ],
            "images": {
                name: {
                    "frames": int(scene.drawn().sum()),
                    "motions": _counts(scene),
                    "references": len(scene.logged),
                    "compared": len(scene.compared),
                }
                for name, scene in scenes.items()
            },
            "failures": dict(failures),
            "published": PUBLISHED,
        }
    )


def warnings(rows: Sequence[LevelRow], scenes: Mapping[str, MeasuredScene]) -> list[str]:
    """What readers of the table should know."""
    found = []
    logged = sum(len(scene.logged) for scene in scenes.values())
    references = next(iter(scenes.values())).references
    fewest = min([logged, *(row.images for row in rows)])
    for features in (column.features for column in COLUMNS.values()):
        if features is None or features not in references:
            continue
        if fewest <= (size := references[features].shape[1]):
            found.append(
                f"{features}: {fewest} images are fewer than {size + 1}, so covariances lack full "
                "rank: compare Frechet distances of equal image counts only"
            )
    return found


def table_markdown(rows: Sequence[LevelRow], notes: Sequence[str]) -> str:
    """The table with the published rows below it."""
    names = [name for name in COLUMNS if any(name in row.values for row in rows)]
    head = ["arm", "images", *(COLUMNS[name].heading for name in names)]
    lines = [_line(head), _line(["---"] * len(head))]
    for row in rows:
        cells = [cell(name, row.values.get(name)).replace("\n", "<br>") for name in names]
        lines.append(_line([row.arm, str(row.images), *cells]))
    shown = [name for name in names if name in next(iter(PUBLISHED.values()))]
    for arm, values in PUBLISHED.items() if shown else ():
        cells = [f"{values[n]:.{COLUMNS[n].digits}f}" if n in values else "" for n in names]
        lines.append(_line([f"paper: {arm}", "", *cells]))
    below = [f"- {note}" for note in notes]
    return "\n".join([*lines, "", *below, ""])


def cell(name: str, value: Value | None) -> str:
    """A number, its interval, and the difference from the first arm."""
    if value is None:
        return ""
    digits = COLUMNS[name].digits
    text = f"{value.value:.{digits}f}\n{value.low:.{digits}f} to {value.high:.{digits}f}"
    if value.difference is not None:
        point, low, high = value.difference
        text += f"\n{point:+.{digits}f} ({low:+.{digits}f} to {high:+.{digits}f})"
    return text


def _counts(scene: MeasuredScene) -> dict[str, int]:
    drawn = scene.drawn()
    found: dict[str, int] = {}
    for index, frame in enumerate(scene.frames):
        key = f"{frame.motion}-{frame.setting}"
        found[key] = found.get(key, 0) + int(drawn[index])
    return found


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
