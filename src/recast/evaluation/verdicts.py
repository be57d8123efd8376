"""Whether a simulated rollout ends as it would in the true world, and how far its TTC is off."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from recast.evaluation.bootstrap import Bootstrap, cluster_bootstrap
from recast.evaluation.grid_row import GridRow
from recast.evaluation.pairs import over_common_steps


@dataclass(frozen=True)
class Verdict:
    """A rollout beside that of the oracle in the same scenario, over the steps that both have.

    Attributes:
        oracle_collided: what truly happens in these steps.
        agrees: whether the rollout says the same.
        ttc_error: its TTC minus the oracle's, seconds; None where one has none.
        plans: how many plans each made in these steps.
        cut: whether one of them went on for longer.
    """

    oracle_collided: bool
    agrees: bool
    ttc_error: float | None
    plans: int
    cut: bool


@dataclass(frozen=True)
class Agreement:
    """The verdicts of a planner under an arm.

    Attributes:
        planner, arm: of the rollouts.
        asked: how many rollouts there should be; where it or the oracle's failed nothing is
            compared.
        pairs, scenes: how many were compared, and in how many scenes.
        plans: how many plans each side made in what was compared.
        cut: how many of the pairs end where one of the two rollouts was cut.
        agreeing: how many collide, or do not, as the oracle's.
        false_collisions: collide where the oracle's do not.
        missed_collisions: do not where the oracle's collide.
        share: of agreeing ones, with its interval over scenes.
        ttc_error: mean absolute TTC error in seconds, likewise; None without a pair.
    """

    planner: str
    arm: str
    asked: int
    pairs: int
    scenes: int
    plans: int
    cut: int
    agreeing: int
    false_collisions: int
    missed_collisions: int
    share: Bootstrap
    ttc_error: Bootstrap | None


def verdicts(rows: Sequence[GridRow], truth: str | None) -> list[Verdict | None]:
    """For each row, how it compares with the same planner's in the truth.

    Args:
        truth: the arm that renders the truth; None if none does.

    Returns:
        None for the truth's own rows, and where either failed.
    """
    if truth is None:
        return [None] * len(rows)
    true = {row.scenario: row for row in rows if row.arm == truth and row.collided is not None}
    return [None if r.arm == truth else _verdict(r, true.get(r.scenario)) for r in rows]


def agreements(rows: Sequence[GridRow], truth: str, samples: int, seed: int) -> list[Agreement]:
    """A line for each planner and arm with a rollout to compare, in the order of the rows.

    Args:
        rows: of the whole grid, those of the truth among them.
        truth: the arm that renders the truth.
        samples: of the bootstrap over scenes.
        seed: of the bootstrap.
    """
    found = zip(rows, verdicts(rows, truth), strict=True)
    compared = [(row, verdict) for row, verdict in found if verdict is not None]
    asked = Counter((row.planner, row.arm) for row in rows)
    return [
        _agreement(
            [(r, v) for r, v in compared if (r.planner, r.arm) == key], asked[key], samples, seed
        )
        for key in dict.fromkeys((row.planner, row.arm) for row, _ in compared)
    ]


def _verdict(row: GridRow, truth: GridRow | None) -> Verdict | None:
    if truth is None or row.collided is None or truth.collided is None:
        return None
    cut = row.steps_run != truth.steps_run
    row, truth = over_common_steps(row, truth)
    mine, true = row.scores.get("ttc"), truth.scores.get("ttc")
    error = None if mine is None or true is None else mine - true
    agrees = row.collided == truth.collided
    return Verdict(bool(truth.collided), agrees, error, min(row.plans, truth.plans), cut)


def _agreement(
    compared: Sequence[tuple[GridRow, Verdict]], asked: int, samples: int, seed: int
) -> Agreement:
    same: dict[str, list[float]] = {}
    errors: dict[str, list[float]] = {}
    for row, verdict in compared:
        same.setdefault(row.scene, []).append(float(verdict.agrees))
        if verdict.ttc_error is not None:
            errors.setdefault(row.scene, []).append(abs(verdict.ttc_error))

    def interval(scenes: dict[str, list[float]]) -> Bootstrap:
        return cluster_bootstrap(list(scenes.values()), np.random.default_rng(seed), samples)

    wrong = [verdict for _, verdict in compared if not verdict.agrees]
    return Agreement(
        planner=compared[0][0].planner,
        arm=compared[0][0].arm,
        asked=asked,
        pairs=len(compared),
        scenes=len(same),
        plans=sum(verdict.plans for _, verdict in compared),
        cut=sum(verdict.cut for _, verdict in compared),
        agreeing=len(compared) - len(wrong),
        false_collisions=sum(not verdict.oracle_collided for verdict in wrong),
        missed_collisions=sum(verdict.oracle_collided for verdict in wrong),
        share=interval(same),
        ttc_error=interval(errors) if errors else None,
    )
