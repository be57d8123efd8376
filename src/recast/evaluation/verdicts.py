"""Whether a simulated rollout ends as it would in the true world, and how far its TTC is off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from recast.evaluation.bootstrap import Bootstrap, cluster_bootstrap
from recast.evaluation.grid_row import GridRow

ORACLE = "oracle"
"""The method that renders the truth."""


@dataclass(frozen=True)
class Verdict:
    """A rollout beside that of the oracle in the same scenario.

    Attributes:
        oracle_collided: what truly happens.
        agrees: whether the rollout says the same.
        ttc_error: its TTC minus the oracle's, seconds; None where one has none.
    """

    oracle_collided: bool
    agrees: bool
    ttc_error: float | None


@dataclass(frozen=True)
class Agreement:
    """A method's verdicts together.

    Attributes:
        method: of the rollouts.
        pairs, scenes: how many were compared, and in how many scenes.
        agreeing: how many collide, or do not, as the oracle's.
        false_collisions: collide where the oracle's do not.
        missed_collisions: do not where the oracle's collide.
        share: of agreeing ones, with its interval over scenes.
        ttc_error: mean absolute TTC error in seconds, likewise; None without a pair.
    """

    method: str
    pairs: int
    scenes: int
    agreeing: int
    false_collisions: int
    missed_collisions: int
    share: Bootstrap
    ttc_error: Bootstrap | None


def verdicts(rows: Sequence[GridRow]) -> list[Verdict | None]:
    """For each row, how it compares; None for the oracle's own and where either failed."""
    truth = {row.scenario: row for row in rows if row.method == ORACLE and row.collided is not None}
    return [_verdict(row, truth.get(row.scenario)) for row in rows]


def agreements(rows: Sequence[GridRow], samples: int, seed: int) -> list[Agreement]:
    """A line for each method that has a rollout to compare, in the order of the rows.

    Args:
        rows: of the whole grid, the oracle's among them.
        samples: of the bootstrap over scenes.
        seed: of the bootstrap.
    """
    compared = [(r, v) for r, v in zip(rows, verdicts(rows), strict=True) if v is not None]
    return [
        _agreement(method, [(r, v) for r, v in compared if r.method == method], samples, seed)
        for method in dict.fromkeys(row.method for row, _ in compared)
    ]


def _verdict(row: GridRow, truth: GridRow | None) -> Verdict | None:
    if truth is None or row.method == ORACLE or row.collided is None or truth.collided is None:
        return None
    mine, true = row.scores.get("ttc"), truth.scores.get("ttc")
    error = None if mine is None or true is None else mine - true
    return Verdict(truth.collided, row.collided == truth.collided, error)


def _agreement(
    method: str, compared: Sequence[tuple[GridRow, Verdict]], samples: int, seed: int
) -> Agreement:
    same: dict[str, list[float]] = {}
    errors: dict[str, list[float]] = {}
    for row, verdict in compared:
        same.setdefault(row.scene, []).append(float(verdict.agrees))
        if verdict.ttc_error is not None:
            errors.setdefault(row.scene, []).append(abs(verdict.ttc_error))

    def interval(scenes: dict[str, list[float]]) -> Bootstrap:
        return cluster_bootstrap(list(scenes.values()), np.random.default_rng(seed), samples)

    wrong = [(row.collided, verdict) for row, verdict in compared if not verdict.agrees]
    return Agreement(
        method=method,
        pairs=len(compared),
        scenes=len(same),
        agreeing=len(compared) - len(wrong),
        false_collisions=sum(collided is True for collided, _ in wrong),
        missed_collisions=sum(collided is False for collided, _ in wrong),
        share=interval(same),
        ttc_error=interval(errors) if errors else None,
    )
