"""The table of the scene-level evaluation, and its files.

Means and Frechet distances have intervals over scenes. Scenes are drawn whole, and the same draws
serve all arms, columns and differences (section 7 of the protocol in docs/scene_level.md). Files
are scene_level.parquet, results.json and table.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.table_files import write_parquet
from recast.metrics.frechet import FeatureStats, frechet_between, frechet_bootstrap
from recast.metrics.scene_level_images import (
    COLUMNS,
    IMAGE_SCORES,
    Features,
    LoggedFrame,
    RolloutFrame,
    image_scores,
)
from recast.metrics.table import cluster_bootstrap, rounded

_LEVEL = 0.95
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


@dataclass(frozen=True)
class MeasuredScene:
    """What a scene contributes.

    Attributes:
        frames, logged: images that count, of all arms; logged images that count.
        compared: indices of the logged images whose crops are compared with.
        arms: features by arm, a row an image.
        references: features of `logged`.
        replay: features of `logged` as the control draws them; None without a control.
    """

    frames: tuple[RolloutFrame, ...]
    logged: tuple[LoggedFrame, ...]
    compared: tuple[int, ...]
    arms: Mapping[str, Features]
    references: Features
    replay: Features | None = None

    def drawn(self) -> NDArray[np.bool_]:
        """(N,) whether every arm could render an image: one that failed leaves all arms."""
        return np.logical_and.reduce(
            [np.asarray(one["drawn"], np.bool_) for one in self.arms.values()]
        )

    def problem(self) -> str | None:
        """Why the scene does not count; None if it does."""
        if not self.frames:
            return "no image of its drives shows a vehicle large and visible enough"
        if not self.logged:
            return "no logged image shows a vehicle large and visible enough"
        if not self.drawn().any():
            return "no image could be rendered for every arm"
        for arm, features in self.arms.items():
            if len(features["drawn"]) != len(self.frames):
                return f"arm {arm} was measured on different images"
        return None


@dataclass(frozen=True)
class Value:
    """A number of the table.

    Attributes:
        value: value over all images.
        low, high: interval of 95 % over scenes.
        scene_mean: mean of the scenes' means; None for a Frechet distance.
        difference: difference from the first arm with its interval; None for the first arm, and for
            rows on other images.
    """

    value: float
    low: float
    high: float
    scene_mean: float | None = None
    difference: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class LevelRow:
    """A line of the table.

    Attributes:
        images: number of images.
        values: values by column.
    """

    arm: str
    images: int
    values: Mapping[str, Value]


def summarise(
    scenes: Mapping[str, MeasuredScene],
    control: str,
    samples: int,
    frechet_samples: int,
    seed: int,
) -> list[LevelRow]:
    """A line for each arm, in order, then one of the control.

    Args:
        scenes: scenes that count, by name; all have the same arms, the first is the baseline.
        control: name of the line of `MeasuredScene.replay`.
        samples, frechet_samples: numbers of bootstrap samples of means and of Frechet distances.

    Raises:
        InputError: no scene, or arms that differ between scenes.
    """
    names = _arms(scenes)
    drawn = {scene: one.drawn() for scene, one in scenes.items()}
    lines = [(arm, {s: one.arms[arm] for s, one in scenes.items()}, drawn) for arm in names]
    replays = {s: one.replay for s, one in scenes.items() if one.replay is not None}
    if len(replays) == len(scenes):
        shown = {s: np.asarray(one["drawn"], np.bool_) for s, one in replays.items()}
        lines.append((control, replays, shown))
    draws = np.random.default_rng(seed).integers(0, len(scenes), (frechet_samples, len(scenes)))
    real = {
        key: {s: FeatureStats.of(np.asarray(one.references[key])) for s, one in scenes.items()}
        for key in (column.features for column in COLUMNS.values())
        if key is not None and all(key in one.references for one in scenes.values())
    }
    rows: list[LevelRow] = []
    first: dict[str, _Sample] = {}
    for arm, features, kept in lines:
        sampled = _scores(scenes, features, kept) | _distances(real, features, kept, draws)
        compared = {} if arm in (names[0], control) else first
        values = {
            name: _value(sampled[name], compared.get(name), samples, seed)
            for name in COLUMNS
            if name in sampled
        }
        first = first or sampled
        rows.append(LevelRow(arm, int(sum(mask.sum() for mask in kept.values())), values))
    return rows


@dataclass(frozen=True)
class _Sample:
    """Scores by scene; or a Frechet distance and its bootstrap draws."""

    scenes: tuple[Array, ...] = ()
    distance: float = 0.0
    draws: Array | None = None


def _scores(
    scenes: Mapping[str, MeasuredScene],
    features: Mapping[str, Features],
    kept: Mapping[str, NDArray[np.bool_]],
) -> dict[str, _Sample]:
    """Scores of images by column; those that every scene has."""
    scored = [
        {
            name: values[kept[scene]]
            for name, values in image_scores(
                one, scenes[scene].references, np.array(scenes[scene].compared, np.int64)
            ).items()
        }
        for scene, one in features.items()
    ]
    common = set.intersection(*(set(scores) for scores in scored))
    return {name: _Sample(tuple(scores[name] for scores in scored)) for name in common}


def _distances(
    real: Mapping[str, Mapping[str, FeatureStats]],
    features: Mapping[str, Features],
    kept: Mapping[str, NDArray[np.bool_]],
    draws: NDArray[np.int64],
) -> dict[str, _Sample]:
    """Frechet distances by column, to the references' statistics by kind and scene."""
    found = {}
    for name, column in COLUMNS.items():
        key = column.features
        if key is None or key not in real or not all(key in one for one in features.values()):
            continue
        ours = {s: FeatureStats.of(np.asarray(f[key])[kept[s]]) for s, f in features.items()}
        distance = frechet_between(
            FeatureStats.merged(list(ours.values())), FeatureStats.merged(list(real[key].values()))
        )
        found[name] = _Sample((), distance, frechet_bootstrap(ours, real[key], draws))
    return found


def _value(one: _Sample, first: _Sample | None, samples: int, seed: int) -> Value:
    if one.draws is not None:
        difference = None
        if first is not None:
            assert first.draws is not None
            difference = (one.distance - first.distance, *_interval(one.draws - first.draws))
        return Value(one.distance, *_interval(one.draws), difference=difference)
    own = cluster_bootstrap(one.scenes, np.random.default_rng(seed), samples)
    difference = None
    if first is not None:
        apart = [mine - theirs for mine, theirs in zip(one.scenes, first.scenes, strict=True)]
        paired = cluster_bootstrap(apart, np.random.default_rng(seed), samples)
        difference = (paired.point, paired.low, paired.high)
    means = float(np.mean([scene.mean() for scene in one.scenes]))
    return Value(own.point, own.low, own.high, means, difference)


def _interval(draws: Array) -> tuple[float, float]:
    tail = 50 * (1 - _LEVEL)
    low, high = np.percentile(draws, [tail, 100 - tail])
    return float(low), float(high)


def _arms(scenes: Mapping[str, MeasuredScene]) -> Sequence[str]:
    if not scenes:
        raise InputError(
            "scene-level", "scenes", "none could be measured", "read the reasons above"
        )
    names = [tuple(one.arms) for one in scenes.values()]
    if len(set(names)) > 1:
        raise InputError("scene-level", "arms", "differ between scenes", "measure all arms again")
    return names[0]


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
