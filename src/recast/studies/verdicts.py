"""Whether rollouts end as they would in the true world, and what each part of a simulation costs.

rollouts.parquet says it of each rollout; its columns are described in docs/bench.md."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from recast.core.table_files import write_parquet
from recast.metrics.table import COLUMNS, Bootstrap, cluster_bootstrap, over_common_steps
from recast.runs.arms import Arm
from recast.studies.grid import GridRow

SCHEMA = pa.schema(
    [
        *((name, pa.string()) for name in ("scene", "world")),
        ("seed", pa.int64()),
        *(
            (name, pa.string())
            for name in ("log", "track_id", "arm", "motion", "setting", "planner")
        ),
        *(
            (name, pa.int64())
            for name in ("start_timestamp_us", "steps_requested", "steps_run", "plans")
        ),
        ("cut_reason", pa.string()),
        *((name, pa.float64()) for name in COLUMNS),
        ("verdict", pa.string()),
        ("first_collision_step", pa.int64()),
        ("map_derived", pa.bool_()),
        ("oracle_verdict", pa.string()),
        ("verdict_agrees", pa.bool_()),
        ("ttc_error", pa.float64()),
        ("plans_compared", pa.int64()),
        ("verdict_trust", pa.float64()),
        ("failure", pa.string()),
        ("failure_reason", pa.string()),
    ]
)
"""Columns and their types; any but scene, arm, motion, setting and planner may be null."""
NOISE_FLOOR = "noise floor"
"""Arm of a `VerdictCounts` over all disturbances of the truth."""
_OF_ROW = tuple(name for name in SCHEMA.names if name in GridRow.__dataclass_fields__)


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
class VerdictCounts:
    """The verdicts of a planner under an arm.

    Attributes:
        asked: how many rollouts there should be; where it or the oracle's failed nothing is
            compared.
        pairs, scenes: how many were compared, and in how many scenes.
        plans: how many plans each side made in what was compared.
        cut: how many of the pairs end where one of the two rollouts was cut.
        agreeing: how many collide, or do not, as the oracle's.
        false_collisions: how many collide where the oracle's do not.
        missed_collisions: how many do not collide where the oracle's do.
        share: share of agreeing rollouts, with its interval over scenes.
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

    def over(self, floor: VerdictCounts | None) -> float | None:
        """Its share over that of the noise floor; None without a floor, or with one of zero."""
        return None if floor is None or not floor.agreeing else self.share.point / floor.share.point


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


def agreements(rows: Sequence[GridRow], truth: str, samples: int, seed: int) -> list[VerdictCounts]:
    """A line for each planner and arm with a rollout to compare, in the order of the rows.

    Args:
        rows: rows of the whole grid, those of the truth among them.
        truth: the arm that renders the truth.
        samples: number of samples of the bootstrap over scenes.
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


def noise_floors(
    rows: Sequence[GridRow], truth: str, noisy: Collection[str], samples: int, seed: int
) -> list[VerdictCounts]:
    """A line for each planner: how often it ends as in the truth if the truth is disturbed.

    No reconstruction can be expected to agree more often.

    Args:
        truth: the arm that renders the truth.
        noisy: arms that disturb it; they count as one arm, `NOISE_FLOOR`.
        samples: number of samples of the bootstrap over scenes.
    """
    pooled = [replace(row, arm=NOISE_FLOOR) for row in rows if row.arm in noisy]
    true = [row for row in rows if row.arm == truth]
    return agreements([*true, *pooled], truth, samples, seed)


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
) -> VerdictCounts:
    same: dict[str, list[float]] = {}
    errors: dict[str, list[float]] = {}
    for row, verdict in compared:
        same.setdefault(row.scene, []).append(float(verdict.agrees))
        if verdict.ttc_error is not None:
            errors.setdefault(row.scene, []).append(abs(verdict.ttc_error))

    def interval(scenes: dict[str, list[float]]) -> Bootstrap:
        return cluster_bootstrap(list(scenes.values()), np.random.default_rng(seed), samples)

    wrong = [verdict for _, verdict in compared if not verdict.agrees]
    return VerdictCounts(
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


def write_rows(rows: Sequence[GridRow], path: Path, truth: str | None) -> None:
    """Write rows, whole or not at all; the same rows give the same bytes.

    Args:
        truth: the arm that renders the truth; None if none does.
    """
    records = [_record(*pair) for pair in zip(rows, verdicts(rows, truth), strict=True)]
    write_parquet(path, pa.Table.from_pylist(records, schema=SCHEMA))


def _record(row: GridRow, verdict: Verdict | None) -> dict[str, object]:
    return {
        **{name: getattr(row, name) for name in _OF_ROW},
        "plans": row.plans if row.failure is None else None,
        **{name: row.scores.get(name) for name in COLUMNS},
        "verdict": _word(row.collided),
        "oracle_verdict": None if verdict is None else _word(verdict.oracle_collided),
        "verdict_agrees": None if verdict is None else verdict.agrees,
        "ttc_error": None if verdict is None else verdict.ttc_error,
        "plans_compared": None if verdict is None else verdict.plans,
        "verdict_trust": None if row.trust is None else row.trust["value"],
    }


def _word(collided: bool | None) -> str | None:
    return None if collided is None else "collision" if collided else "no collision"


_LEFT_OUT = {"light": "relit", "refinement": "refine"}
"""Parts that an arm of its own leaves out, and the member that says so."""


class VerdictPart(NamedTuple):
    """Two arms that differ in one part alone.

    Attributes:
        arm: arm in which the part is as it should be.
        other: arm in which the part is wrong, or missing.
    """

    name: str
    arm: str
    other: str


@dataclass(frozen=True)
class PartLoss:
    """What a part costs a planner, over the scenarios that both arms have.

    Attributes:
        part, arm, other: see `VerdictPart`.
        pairs, scenes: how many scenarios, and in how many scenes.
        agreeing, other_agreeing: how many verdicts of each arm are those of the truth.
        loss: share of agreeing verdicts of `arm` minus that of `other`, with its interval over
            scenes.
    """

    planner: str
    part: str
    arm: str
    other: str
    pairs: int
    scenes: int
    agreeing: int
    other_agreeing: int
    loss: Bootstrap


def part_losses(
    rows: Sequence[GridRow], truth: str, parts: Sequence[VerdictPart], samples: int, seed: int
) -> list[PartLoss]:
    """A line for each planner and part with a scenario to compare.

    Args:
        truth: the arm that renders the truth; its verdicts all agree.
        samples: number of samples of the bootstrap over scenes.
    """
    agrees: dict[str, dict[tuple[str, ...], bool]] = {}
    for row, verdict in zip(rows, verdicts(rows, truth), strict=True):
        if verdict is not None:
            agrees.setdefault(row.arm, {})[row.scenario] = verdict.agrees
        elif row.arm == truth and row.collided is not None:
            agrees.setdefault(truth, {})[row.scenario] = True
    found = []
    for planner in dict.fromkeys(row.planner for row in rows):
        for part in parts:
            mine, others = agrees.get(part.arm, {}), agrees.get(part.other, {})
            both = [key for key in mine if key in others and key[-1] == planner]
            if not both:
                continue
            scenes: dict[str, list[float]] = {}
            for key in both:
                scenes.setdefault(key[0], []).append(float(mine[key]) - float(others[key]))
            loss = cluster_bootstrap(list(scenes.values()), np.random.default_rng(seed), samples)
            found.append(
                PartLoss(
                    planner=planner,
                    part=part.name,
                    arm=part.arm,
                    other=part.other,
                    pairs=len(both),
                    scenes=len(scenes),
                    agreeing=sum(mine[key] for key in both),
                    other_agreeing=sum(others[key] for key in both),
                    loss=loss,
                )
            )
    return found


def parts_of(arms: Sequence[Arm]) -> tuple[VerdictPart, ...]:
    """Every pair of arms that differ in one part alone, part by part.

    Args:
        arms: arms with the run's settings filled in, see `RunConfig.arm`.
    """
    arms = [arm for arm in arms if arm.noise is None]
    without = {
        part: [(one, other) for one in arms for other in arms if _lacks(other, one, member)]
        for part, member in _LEFT_OUT.items()
    }
    lacking = [other.name for pairs in without.values() for _, other in pairs]
    whole = [arm for arm in arms if arm.name not in lacking]
    pairs = [(one, other) for one in whole for other in whole]
    found = {
        "street": [pair for pair in pairs if _other_street(*pair)],
        "vehicle": [pair for pair in pairs if _other_vehicle(*pair, ("generated", "own"))],
        **without,
        "no vehicle": [pair for pair in pairs if _other_vehicle(*pair, ("none",))],
    }
    return tuple(
        VerdictPart(name, one.name, other.name)
        for name, both in found.items()
        for one, other in both
    )


def _lacks(arm: Arm, other: Arm, member: str) -> bool:
    """Whether an arm is another one but for a part that it leaves out."""
    return (
        getattr(arm, member) is False
        and getattr(other, member) is not False
        and _members(arm, member) == _members(other, member)
    )


def _other_street(true: Arm, arm: Arm) -> bool:
    return (
        not true.reconstructs
        and arm.reconstructs
        and _members(true, "street") == _members(arm, "street")
    )


def _other_vehicle(true: Arm, arm: Arm, vehicles: Sequence[str]) -> bool:
    return true.vehicle == "truth" and arm.vehicle in vehicles and true.street == arm.street


def _members(arm: Arm, *left_out: str) -> dict[str, Any]:
    return arm.model_dump(exclude={"name", *left_out})
