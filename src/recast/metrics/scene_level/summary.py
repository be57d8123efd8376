"""The table of the scene-level evaluation: means and Frechet distances with intervals over scenes.

Scenes are drawn whole, and the same draws serve all arms, columns and differences (section 7 of the
protocol in docs/scene_level.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array
from recast.core.errors import InputError
from recast.metrics.frechet import FeatureStats, frechet_between, frechet_bootstrap
from recast.metrics.pairs import cluster_bootstrap
from recast.metrics.scene_level.frames import LoggedFrame, RolloutFrame
from recast.metrics.scene_level.scores import COLUMNS, Features, image_scores

_LEVEL = 0.95


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
