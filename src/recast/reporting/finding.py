"""What a run found, in a sentence for each scenario and one moment for the first screen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from recast.core.files import read_json, write_json
from recast.dynamics import state as ego
from recast.metrics import RolloutMetrics
from recast.metrics.rollout_metrics import least_gaps
from recast.reporting.inputs import NotMade, ReportInputs, ScenarioPart
from recast.reporting.moments import actor_bearings
from recast.reporting.summary import (
    listed,
    looked_at,
    same_endings,
    scored,
    trust_figure,
    vehicles,
)

_STANDING = 0.5
"""Speed in m/s below which the ego stands."""
_BEFORE_S = 1.0
"""Seconds before the first contact at which the vehicle is shown: nearer, it fills the image."""
_IN_VIEW = 0.3
"""Radians between directions to the vehicle that one camera shows well."""


FINDING_FILE = "finding.json"
"""`RunFinding` in the report's folder, for terminals and scripts."""


@dataclass(frozen=True)
class RunFinding:
    """What the first screen says.

    Attributes:
        scenario: number of the scenario that tells most.
        sentences: the ending with each arm, then what that means.
        step: step of the rollouts at which to look.
        moment: the moment in words.
        trust: trust in each verdict, in words; empty if it is not known.
        provisional: whether the trust comes from a calibration on few scenes.
    """

    scenario: int
    sentences: tuple[str, ...]
    step: int
    moment: str
    trust: str
    provisional: bool

    def write(self, report: Path) -> None:
        """Write `FINDING_FILE` into the folder of a report."""
        write_json(report / FINDING_FILE, asdict(self))

    @classmethod
    def read(cls, report: Path) -> RunFinding | None:
        """The finding of a report that this version wrote; None if the run had none."""
        path = report / FINDING_FILE
        if not path.is_file():
            return None
        told = read_json(path)
        return cls(**{**told, "sentences": tuple(told["sentences"])})


def finding(run: ReportInputs) -> RunFinding | None:
    """The scenario that tells most, and what it tells; None without a scored rollout.

    A scenario in which the verdict depends on the vehicle tells most, then one in which no arm has
    the true verdict; of those alike, the one in which most of the vehicle was invented.
    """
    if isinstance(run.scenarios, NotMade):
        return None
    numbered = [(i, one) for i, one in enumerate(run.scenarios) if scored(one)]
    if not numbered:
        return None
    number, scenario = max(numbered, key=lambda one: _telling(run, one[1]))
    by_arm = scored(scenario)
    metrics = list(by_arm.values())
    sentences = [*_sightless(scenario), f"{endings(scenario, run.arms)} {_meaning(run, by_arm)}"]
    if len(numbered) > 1 and run.truth_arm is not None:
        sentences.extend(same_endings(run, run.scenarios, run.truth_arm))
    hits = [step for one in metrics if (step := one.collision.first_step) is not None]
    dt = metrics[0].rollout.dt
    if hits:
        step = _beside(metrics, max(min(hits) - round(_BEFORE_S / dt), 0))
        first = [arm for arm, one in by_arm.items() if one.collision.first_step == min(hits)]
        whose = vehicles([run.arms[arm] for arm in first])
        moment = f"{(min(hits) - step) * dt:g} s before the contact with {whose}"
    else:
        gaps = min((least_gaps(one.rollout) for one in metrics), key=lambda gaps: gaps.min())
        nearest = int(np.argmin(gaps))
        step = _beside(metrics, nearest)
        before = "before " if step < nearest else ""
        moment = f"{before}the smallest gap, {step * dt:.1f} s after the start"
    trust, provisional = _trust(run, scenario)
    return RunFinding(number, tuple(sentences), step, moment, trust, provisional)


def _beside(metrics: Sequence[RolloutMetrics], latest: int) -> int:
    """The last step until `latest` at which one camera shows the vehicle in every rollout.

    Later, one ego may have steered past it while another drives towards it.
    """
    steps = np.arange(latest + 1)
    bearings = [
        actor_bearings(one.rollout)[np.minimum(steps, one.rollout.steps_run)] for one in metrics
    ]
    apart = [np.abs(np.angle(np.exp(1j * (one - bearings[0])))) for one in bearings]
    near = np.flatnonzero(np.max(apart, axis=0) < _IN_VIEW)
    return int(near[-1]) if len(near) else latest


def endings(scenario: ScenarioPart, arms: Mapping[str, str]) -> str:
    """How a scenario ended with each arm, as a sentence; arms that ended alike are named together.

    Empty without a scored rollout.
    """
    alike: dict[str, dict[str, str]] = {}
    subject = ""
    for arm, metrics in scored(scenario).items():
        words, number = _ending(metrics)
        alike.setdefault(words, {})[arms[arm]] = number
        subject = metrics.planner
    told: list[str] = []
    for words, numbers in alike.items():
        several = list(numbers.values())
        numbered = words.format(listed(several if len(set(several)) > 1 else several[:1]))
        told.append(f"with {vehicles(list(numbers))}, {'it' if told else subject} {numbered}")
    return f"{scenario.title}: {'; '.join(told)}." if told else ""


def _ending(metrics: RolloutMetrics) -> tuple[str, str]:
    """How a rollout ended: words with a place for a number, and the number."""
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
        return f"stops {{}} m before the {rollout.noun}{off}", gap
    return f"comes within {{}} m of the {rollout.noun}, without contact{off}", gap


def _telling(run: ReportInputs, scenario: ScenarioPart) -> tuple[int, float]:
    covered = [part.coverage for part in scenario.rollouts if part.coverage is not None]
    invented = max((looked_at(one).mean.invented for one in covered), default=0.0)
    metrics = scored(scenario)
    truth = metrics.pop(run.truth_arm or "", None)
    if truth is not None:
        right = {one.same_verdict(truth) for one in metrics.values()}
        return 2 if len(right) == 2 else int(False in right), invented
    first, *others = metrics.values()
    return 2 * int(not all(first.same_verdict(other) for other in others)), invented


def _meaning(run: ReportInputs, metrics: Mapping[str, RolloutMetrics]) -> str:
    """What the verdicts say of the vehicles."""
    others = {arm: one for arm, one in metrics.items() if arm != run.truth_arm}
    truth = metrics.get(run.truth_arm or "")
    if truth is not None and others:
        right = [run.arms[arm] for arm, one in others.items() if one.same_verdict(truth)]
        verdict = "no collision" if truth.collision.nc.value == 1.0 else "collision"
        if len(right) == len(others):
            return f"The verdict is the true one: {verdict}."
        if not right:
            return f"The true verdict is another one: {verdict}."
        gives = "gives" if len(right) == 1 else "give"
        return f"Only {vehicles(right)} {gives} the true verdict: {verdict}."
    if len(others) < 2:
        return ""
    first, *rest = others.values()
    if all(first.same_verdict(one) for one in rest):
        return "The verdict (collision or not) is the same with all."
    return "The verdict depends on the target's looks; a recording has no truth to decide by."


def _sightless(scenario: ScenarioPart) -> list[str]:
    """A sentence on a planner that looks at no images; none of one that does."""
    blind = (part for part in scenario.rollouts if part.trust and part.trust.features is None)
    named = {part.metrics.planner for part in blind if isinstance(part.metrics, RolloutMetrics)}
    return [
        f"{planner} uses no images, so it drives alike however the target looks; name a planner "
        "that does, such as gtrs-mini."
        for planner in named
    ]


def _trust(run: ReportInputs, scenario: ScenarioPart) -> tuple[str, bool]:
    """Trust in each verdict of a planner that looks, and whether it is provisional."""
    judged = {
        run.arms[part.arm]: part.trust
        for part in scenario.rollouts
        if part.trust is not None and part.trust.features is not None
    }
    words = ", ".join(f"{arm} {trust_figure(trust.value)}" for arm, trust in judged.items())
    return words, any(trust.provisional for trust in judged.values())
