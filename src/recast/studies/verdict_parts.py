"""How much agreement with the truth each part of a simulation costs: street, vehicle, light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from recast.metrics.pairs import Bootstrap, cluster_bootstrap
from recast.runs.arms import Arm
from recast.studies.grid_rows import GridRow
from recast.studies.verdicts import verdicts

_LEFT_OUT = {"light": "relit", "refinement": "refine"}
"""Parts that an arm of its own leaves out, and the member that says so."""


class VerdictPart(NamedTuple):
    """Two arms that differ in one part alone.

    Attributes:
        name: name of the part.
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
        rows: rows of the whole grid.
        truth: the arm that renders the truth; its verdicts all agree.
        samples: number of samples of the bootstrap over scenes.
        seed: seed of the bootstrap.
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
