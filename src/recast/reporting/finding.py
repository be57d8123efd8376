"""What a run found, in a sentence for each scenario and one moment for the first screen."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from recast.dynamics import state as ego
from recast.metrics import RolloutMetrics
from recast.metrics.rollout_metrics import least_gaps
from recast.metrics.table import over_common_steps
from recast.reporting.inputs import NotMade, ReportInputs, RolloutPart, ScenarioPart
from recast.reporting.summary import listed, looked_at, same_endings, vehicles

_STANDING = 0.5
"""Speed in m/s below which the ego stands."""
_BEFORE_S = 1.0
"""Seconds before the first contact at which the vehicle is shown: nearer, it fills the image."""


@dataclass(frozen=True)
class RunFinding:
    """What the first screen says.

    Attributes:
        scenario: number of the scenario that tells most.
        sentences: the ending with each arm, then what that means.
        step: step of the rollouts at which to look.
        moment: the moment in words.
        trust: trust in each verdict, in words; empty if it is not known.
    """

    scenario: int
    sentences: tuple[str, ...]
    step: int
    moment: str
    trust: str


def finding(run: ReportInputs) -> RunFinding | None:
    """The scenario that tells most, and what it tells; None without a scored rollout.

    A scenario in which the verdict depends on the vehicle tells most, then one in which no arm has
    the true verdict; of those alike, the one in which most of the vehicle was invented.
    """
    if isinstance(run.scenarios, NotMade):
        return None
    numbered = [(i, one) for i, one in enumerate(run.scenarios) if _scored(one)]
    if not numbered:
        return None
    number, scenario = max(numbered, key=lambda one: _telling(run, one[1]))
    parts = _scored(scenario)
    sentences = [
        *_sightless(parts.values()),
        f"{endings(scenario, run.arms)} {_meaning(run, parts)}",
    ]
    if len(numbered) > 1 and run.truth_arm is not None:
        sentences.extend(same_endings(run, run.scenarios, run.truth_arm))
    metrics = [_metrics(part) for part in parts.values()]
    hits = [step for one in metrics if (step := one.collision.first_step) is not None]
    dt = metrics[0].rollout.dt
    if hits:
        step = max(min(hits) - round(_BEFORE_S / dt), 0)
        moment = f"{(min(hits) - step) * dt:g} s before the first contact"
    else:
        nearest = min(metrics, key=lambda one: float(least_gaps(one.rollout).min()))
        step = int(np.argmin(least_gaps(nearest.rollout)))
        moment = f"the smallest gap, {step * dt:.1f} s after the start"
    return RunFinding(number, tuple(sentences), step, moment, _trust(run, parts))


def endings(scenario: ScenarioPart, arms: Mapping[str, str]) -> str:
    """How a scenario ended with each arm, as a sentence; arms that ended alike are named together.

    Empty without a scored rollout.
    """
    parts = [(arm, part) for arm, part in _scored(scenario).items() if arm in arms]
    alike: dict[str, dict[str, str]] = {}
    subject = ""
    for arm, part in parts:
        words, number = _ending(part)
        alike.setdefault(words, {})[arms[arm]] = number
        subject = _metrics(part).planner
    told: list[str] = []
    for words, numbers in alike.items():
        several = list(numbers.values())
        numbered = words.format(listed(several if len(set(several)) > 1 else several[:1]))
        told.append(f"with {vehicles(list(numbers))}, {'it' if told else subject} {numbered}")
    return f"{scenario.title}: {'; '.join(told)}." if told else ""


def _scored(scenario: ScenarioPart) -> dict[str, RolloutPart]:
    return {
        part.arm: part for part in scenario.rollouts if isinstance(part.metrics, RolloutMetrics)
    }


def _metrics(part: RolloutPart) -> RolloutMetrics:
    assert isinstance(part.metrics, RolloutMetrics)  # `_scored` gives no others
    return part.metrics


def _ending(part: RolloutPart) -> tuple[str, str]:
    """How a rollout ended: words with a place for a number, and the number."""
    metrics = _metrics(part)
    rollout = metrics.rollout
    off = " and leaves the road" if metrics.drivable.first_step is not None else ""
    if metrics.contact_speed is not None:
        fault = "at fault" if metrics.nc_at_fault.value == 0.0 else "not at fault"
        return f"collides at {{}} m/s ({fault}){off}", f"{metrics.contact_speed:.1f}"
    gaps = least_gaps(rollout)
    nearest = int(np.argmin(gaps))
    gap = f"{gaps[nearest]:.1f}" if gaps[nearest] < 10 else f"{gaps[nearest]:.0f}"
    heading = rollout.ego[nearest, ego.HEADING]
    ahead = rollout.actor[nearest, :2] - rollout.ego[nearest, :2]
    before = float(ahead @ np.array([np.cos(heading), np.sin(heading)])) > 0
    if before and rollout.ego[nearest, ego.VX] < _STANDING:
        return f"stops {{}} m before the vehicle{off}", gap
    return f"comes within {{}} m of the vehicle, without contact{off}", gap


def _same(one: RolloutPart, other: RolloutPart) -> bool:
    """Whether two rollouts have the same verdict, over the steps that both have."""
    a, b = over_common_steps(_metrics(one), _metrics(other))
    return a.collision.nc.value == b.collision.nc.value


def _telling(run: ReportInputs, scenario: ScenarioPart) -> tuple[int, float]:
    parts = _scored(scenario)
    covered = [part.coverage for part in parts.values() if part.coverage is not None]
    invented = max((looked_at(one).mean.invented for one in covered), default=0.0)
    truth = parts.pop(run.truth_arm or "", None)
    if truth is not None:
        right = {_same(part, truth) for part in parts.values()}
        return 2 if len(right) == 2 else int(False in right), invented
    first, *others = parts.values()
    return 2 * int(not all(_same(first, other) for other in others)), invented


def _meaning(run: ReportInputs, parts: Mapping[str, RolloutPart]) -> str:
    """What the verdicts say of the vehicles."""
    others = {arm: part for arm, part in parts.items() if arm != run.truth_arm}
    truth = parts.get(run.truth_arm or "")
    if truth is not None and others:
        right = [run.arms[arm] for arm, part in others.items() if _same(part, truth)]
        wrong = [run.arms[arm] for arm, part in others.items() if not _same(part, truth)]
        verdict = "no collision" if _metrics(truth).collision.nc.value == 1.0 else "collision"
        if not wrong:
            return f"The verdict is the true one: {verdict}."
        if not right:
            return f"The true verdict is another one: {verdict}."
        return f"The true verdict, {verdict}, comes with {vehicles(right)} alone."
    if len(others) < 2:
        return ""
    first, *rest = others.values()
    if all(_same(first, part) for part in rest):
        return "The verdict (collision or not) is the same with all."
    return "The verdict depends on the vehicle's looks; a recording has no truth to decide by."


def _sightless(parts: Iterable[RolloutPart]) -> list[str]:
    """A sentence on a planner that looks at no images; none of one that does."""
    named = {
        _metrics(part).planner
        for part in parts
        if part.trust is not None and part.trust.features is None
    }
    return [
        f"{planner} uses no images, so it drives alike however the vehicle looks; name a planner "
        "that does, such as gtrs-mini."
        for planner in named
    ]


def _trust(run: ReportInputs, parts: Mapping[str, RolloutPart]) -> str:
    known = {
        arm: part.trust
        for arm, part in parts.items()
        if part.trust is not None and part.trust.features is not None
    }
    told = [f"{run.arms[arm]} {trust.value:.2f}" for arm, trust in known.items()]
    return ", ".join(told)
