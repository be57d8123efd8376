"""The table of a generation study, and how sure it is that one model is better than another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from recast.metrics.actor_scores import ACTOR_COLUMNS, ActorColumn, mean_scores
from recast.metrics.features import FEATURE_KINDS
from recast.metrics.frechet import frechet_distance
from recast.metrics.pairs import SAMPLES, Bootstrap, cluster_bootstrap
from recast.studies.generation.cell import StudyCell

STUDY_COLUMNS: Mapping[str, ActorColumn] = {
    **ACTOR_COLUMNS,
    "toy": ActorColumn("toy distance", "", False, 4),
    "fd_inception": ActorColumn("FD Inception", "", False, 3),
    "fd_dino": ActorColumn("FD DINOv2", "", False, 2),
    "fd_toy": ActorColumn("FD toy", "", False, 4),
}
"""Scores in the order of the table. Those that begin with `fd_` are of all pictures together."""


@dataclass(frozen=True)
class StudyRow:
    """A model's line of a table.

    Attributes:
        made: vehicles that it made, of all it was asked for.
        scores: means over the block's vehicles, each counting the same, and Frechet distances.
    """

    model: str
    made: int
    scores: Mapping[str, float]


@dataclass(frozen=True)
class StudyDifference:
    """Candidate minus baseline over the block's vehicles, which are drawn whole.

    Attributes:
        candidate, baseline: names of models.
        score: key of `STUDY_COLUMNS`.
        interval: the mean difference and its interval.
    """

    candidate: str
    baseline: str
    score: str
    interval: Bootstrap

    @property
    def better(self) -> str | None:
        """The model that the interval says is better; None where it holds zero."""
        if self.interval.low <= 0.0 <= self.interval.high:
            return None
        higher = self.candidate if self.interval.low > 0 else self.baseline
        lower = self.baseline if self.interval.low > 0 else self.candidate
        return higher if STUDY_COLUMNS[self.score].higher else lower


@dataclass(frozen=True)
class StudyBlock:
    """One condition, such as clean inputs.

    Attributes:
        identities: vehicles that every model made; all figures are over these.
        views: pictures that they were compared in.
        failures: reason why a vehicle could not be made, by model and vehicle.
        rows: rows of the models, in their order.
        differences: differences of consecutive models.
        vehicles: mean scores over a vehicle's views, by vehicle and model.
    """

    condition: str
    identities: tuple[str, ...]
    views: int
    failures: Mapping[str, Mapping[str, str]]
    rows: tuple[StudyRow, ...]
    differences: tuple[StudyDifference, ...]
    vehicles: Mapping[str, Mapping[str, Mapping[str, float]]]


def summarize(
    condition: str,
    cells: Mapping[str, Sequence[StudyCell]],
    truth: Mapping[str, StudyCell],
    *,
    seed: int = 0,
    samples: int = SAMPLES,
) -> StudyBlock:
    """Table and paired differences of one condition.

    Args:
        cells: cells by model, one for every vehicle.
        truth: the photographs' features, by vehicle.
        seed: seed of the bootstrap; every difference sees the same draws.
        samples: number of bootstrap samples.

    Raises:
        ValueError: no vehicle was made by every model.
    """
    failures = {
        model: {cell.id: cell.failure for cell in mine if cell.failure is not None}
        for model, mine in cells.items()
    }
    identities = tuple(id for id in truth if not any(id in failed for failed in failures.values()))
    if not identities:
        raise ValueError(
            f"summarize: there is no vehicle that every model made from {condition} inputs"
        )
    chosen = {
        model: {cell.id: cell for cell in mine if cell.id in set(identities)}
        for model, mine in cells.items()
    }
    scored = {
        model: {id: view_scores(mine[id], truth[id]) for id in identities}
        for model, mine in chosen.items()
    }
    vehicles = {id: {model: mean_scores(scored[model][id]) for model in cells} for id in identities}
    rows = []
    for model in cells:
        means = mean_scores([vehicles[id][model] for id in identities])
        means |= _frechet(
            [chosen[model][id] for id in identities], [truth[id] for id in identities]
        )
        ordered = {key: means[key] for key in STUDY_COLUMNS if key in means}
        rows.append(StudyRow(model, len(cells[model]) - len(failures[model]), ordered))
    differences = [
        StudyDifference(candidate, baseline, key, interval)
        for baseline, candidate in pairwise(cells)
        for key in STUDY_COLUMNS
        if key in vehicles[identities[0]][candidate]
        for interval in [_interval(scored[candidate], scored[baseline], key, seed, samples)]
    ]
    views = sum(len(truth[id].views) for id in identities)
    return StudyBlock(
        condition, identities, views, failures, tuple(rows), tuple(differences), vehicles
    )


def view_scores(cell: StudyCell, truth: StudyCell) -> list[dict[str, float]]:
    """Of every view, the scores that a cell holds and those by features."""
    found = [dict(scores) for scores in cell.scores]
    for name, features in cell.features.items():
        kind = FEATURE_KINDS[name]
        if kind.score is None or kind.compare is None:
            continue
        for scores, one, other in zip(found, features, truth.features[name], strict=True):
            scores[kind.score] = kind.compare(one.astype(np.float64), other.astype(np.float64))
    return found


def _frechet(cells: Sequence[StudyCell], truth: Sequence[StudyCell]) -> dict[str, float]:
    """Distances between all pictures of a model and all photographs, where there are two."""
    found: dict[str, float] = {}
    for name in cells[0].features:
        column = FEATURE_KINDS[name].frechet
        drawn = np.concatenate([cell.features[name] for cell in cells])
        if column is not None and len(drawn) > 1:
            photographs = np.concatenate([cell.features[name] for cell in truth])
            found[column] = frechet_distance(drawn, photographs)
    return found


def _interval(
    candidate: Mapping[str, Sequence[Mapping[str, float]]],
    baseline: Mapping[str, Sequence[Mapping[str, float]]],
    key: str,
    seed: int,
    samples: int,
) -> Bootstrap:
    # by vehicle, not by view: a vehicle counts the same however many views it has
    pairs = [
        np.mean([one[key] for one in candidate[id]]) - np.mean([one[key] for one in baseline[id]])
        for id in candidate
    ]
    return cluster_bootstrap(pairs, np.random.default_rng(seed), samples)
