"""How the arms' drives compare with each other and with the truth's, in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from recast.evaluation import RolloutMetrics
from recast.evaluation.pairs import over_common_steps
from recast.reporting.inputs import NotMade, ReportInputs, RolloutPart, ScenarioPart
from recast.simulation.rollout import Rollout


def driving_note(scenario: ScenarioPart, arms: Mapping[str, str]) -> str | None:
    """Which arms led to exactly the same driving, in words; None where none did."""
    groups: list[list[RolloutPart]] = []
    for part in sorted(scenario.rollouts, key=lambda part: list(arms).index(part.arm)):
        rollout = part.rollout
        if not isinstance(rollout, Rollout):
            continue
        for group in groups:
            other = group[0].rollout
            assert isinstance(other, Rollout)
            if np.array_equal(other.ego, rollout.ego):
                group.append(part)
                break
        else:
            groups.append([part])
    if len(groups) == 1 and len(groups[0]) > 1:
        return (
            "The ego drove exactly alike with all arms: to this planner, or in this scenario, "
            "the pictures made no difference."
        )
    alike = [listed([arms[part.arm] for part in group]) for group in groups if group[1:]]
    return f"The ego drove exactly alike with {'; and with '.join(alike)}." if alike else None


def truth_gaps(run: ReportInputs, scenario: ScenarioPart) -> str | None:
    """How far from the truth's path each arm led the ego, in words; None without a truth."""
    parts = {part.arm: part.rollout for part in scenario.rollouts}
    truth = parts.get(run.truth_arm or "")
    if not isinstance(truth, Rollout):
        return None
    told = []
    for arm, title in run.arms.items():
        rollout = parts.get(arm)
        if arm == run.truth_arm or not isinstance(rollout, Rollout):
            continue
        steps = min(len(rollout.ego), len(truth.ego))
        away = np.hypot(*(rollout.ego[:steps, :2] - truth.ego[:steps, :2]).T)
        told.append(f"{title} {away.mean():.2f} m on average, {away.max():.2f} m at most")
    if not told:
        return None
    return f"Gap to the truth, distance of the ego from where it led: {'; '.join(told)}."


def same_endings(
    run: ReportInputs, scenarios: Sequence[ScenarioPart], truth: str
) -> tuple[str, ...]:
    """In how many scenarios each arm ended as the truth did, contact or none.

    Where one of the two rollouts was cut, both are looked at up to there.
    """
    told = []
    for arm, title in run.arms.items():
        pairs = [
            over_common_steps(scored[arm], scored[truth])
            for scenario in scenarios
            if {arm, truth} <= (scored := _scored(scenario)).keys()
        ]
        if arm != truth and pairs:
            same = sum(a.collision.nc.value == b.collision.nc.value for a, b in pairs)
            told.append(f"{title}: {same} of {len(pairs)}")
    return (f"Ended as with the truth, in contact or without: {'; '.join(told)}.",) if told else ()


def _scored(scenario: ScenarioPart) -> dict[str, RolloutMetrics]:
    return {
        part.arm: part.metrics
        for part in scenario.rollouts
        if not isinstance(part.metrics, NotMade)
    }


def listed(names: Sequence[str]) -> str:
    """Names as in a sentence: a, a and b, a, b and c."""
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
