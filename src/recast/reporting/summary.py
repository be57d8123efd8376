"""What the page says in words: how each arm ended and compares, and whether to trust the run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from recast.actors.actor import Coverage
from recast.logs.types import PEOPLE
from recast.metrics import RolloutMetrics
from recast.metrics.plan_agreement import MOVED, PlanAgreement, read_agreement
from recast.metrics.rollout_metrics import contacts_of_others
from recast.reporting.inputs import (
    ActorPart,
    NotMade,
    RegistrationPart,
    ReportInputs,
    RolloutPart,
    ScenarioPart,
    ScenePart,
    TruthPart,
)
from recast.reporting.plots import Series, series
from recast.reporting.tables import Tone
from recast.simulation.rollout import ANY_VEHICLE, Rollout, RolloutFailure
from recast.simulation.scene_renderer import RolloutCoverage


@dataclass(frozen=True)
class RolloutEvent:
    """Something that happened in a rollout, `time` seconds after its start, and its tone."""

    time: float
    text: str
    tone: Tone


@dataclass(frozen=True)
class RolloutOutcome:
    """How one rollout ended, in a few words; `trust` in its verdict is None if it is not known."""

    text: str
    tone: Tone
    trust: float | None = None


def rollout_events(part: RolloutPart, curves: Series) -> tuple[RolloutEvent, ...]:
    """Contacts, leaving the road, the worst plan, discomfort and the cut, in order of time."""
    rollout = part.rollout
    assert isinstance(rollout, Rollout)
    events = []
    hit = curves.collision_step
    if hit is not None:
        text = "contact"
        if not isinstance(part.metrics, NotMade):
            text += f" at a relative speed of {part.metrics.contact_speed or 0.0:.1f} m/s"
        events.append(RolloutEvent(float(curves.time[hit]), text, "bad"))
    else:
        nearest = int(np.argmin(curves.gap))
        text = f"smallest gap, {curves.gap[nearest]:.1f} m"
        events.append(RolloutEvent(float(curves.time[nearest]), text, "plain"))
    if not isinstance(part.metrics, NotMade):
        metrics = part.metrics
        off = metrics.drivable.first_step
        if off is not None:
            events.append(
                RolloutEvent(
                    off * rollout.dt, f"off the road: {metrics.drivable.dac.reason}", "bad"
                )
            )
        if metrics.ttc.ttc.value is not None and metrics.ttc.ttc.reason is not None:
            worst = int(np.argmin(metrics.ttc.per_cycle))
            text = f"worst plan: meets the actor after {metrics.ttc.ttc.value:.1f} s"
            events.append(RolloutEvent(float(curves.plan_time[worst]), text, "warn"))
        bad = np.flatnonzero(~metrics.comfort.passed.all(axis=1))
        if len(bad):
            text = f"first uncomfortable plan ({metrics.comfort.com.reason})"
            events.append(RolloutEvent(float(curves.plan_time[bad[0]]), text, "warn"))
    for one, other, step in contacts_of_others(rollout) if rollout.traffic else ():
        text = f"track {one} and track {other} touch; neither is the ego"
        events.append(RolloutEvent(step * rollout.dt, text, "warn"))
    if rollout.cut_reason is not None:
        asked = rollout.steps_requested * rollout.dt
        text = f"cut before {asked:.1f} s: {rollout.cut_reason}"
        events.append(RolloutEvent(float(curves.time[-1]), text, "warn"))
    return tuple(sorted(events, key=lambda event: event.time))


def outcomes(run: ReportInputs) -> tuple[tuple[str, tuple[RolloutOutcome, ...]], ...]:
    """By scenario, its title and how it ended under each arm, in the order of the arms."""
    if isinstance(run.scenarios, NotMade):
        return ()
    rows = []
    for scenario in run.scenarios:
        parts = {part.arm: part for part in scenario.rollouts}
        cells = [
            outcome(parts[arm]) if arm in parts else RolloutOutcome("not driven", "warn")
            for arm in run.arms
        ]
        if run.truth_arm is not None:  # it is not judged: the others are judged by it
            truth = list(run.arms).index(run.truth_arm)
            cells[truth] = replace(cells[truth], tone="plain")
        rows.append((scenario.title, tuple(cells)))
    return tuple(rows)


def why_missing(rollout: Rollout | RolloutFailure | NotMade) -> str:
    """Why there is no rollout, in words; empty where there is one."""
    if isinstance(rollout, RolloutFailure):
        return f"the rollout failed: {rollout.reason} ({rollout.error})"
    return rollout.reason if isinstance(rollout, NotMade) else ""


def headline(run: ReportInputs) -> tuple[str, ...]:
    """Sentences on what was simulated and how it ended."""
    if isinstance(run.scenarios, NotMade) or not run.scenarios:
        return ("No rollouts were made.",)
    actor = run.actor.name if isinstance(run.actor, ActorPart) else "the chosen road user"
    names = [title for arm, title in run.arms.items() if arm != run.truth_arm]
    parts = [part for scenario in run.scenarios for part in scenario.rollouts]
    rollouts = [part.rollout for part in parts if isinstance(part.rollout, Rollout)]
    planners = sorted({r.planner for r in rollouts})
    motions = "; ".join(scenario.title for scenario in run.scenarios)
    first = f"In the log {run.log}, {actor} was given a new motion: {motions}. "
    driven = names or list(run.arms.values())
    first += f"{'Each was driven' if driven[1:] else 'Driven'} with {vehicles(driven)}"
    if run.truth_arm is not None and names:
        first += f", and with {vehicles([run.arms[run.truth_arm]])}, which is the ground truth"
    first += f"; planner: {listed(planners)}." if planners else "."
    lines = [first]
    outcomes = [f"{title}: {_contacts(run.scenarios, arm)}" for arm, title in run.arms.items()]
    lines.append("Rollouts that ended without contact: " + "; ".join(outcomes) + ".")
    failed = [part for part in parts if not isinstance(part.rollout, Rollout)]
    if failed:
        lines.append(f"{len(failed)} of {len(parts)} rollouts could not be run; see below.")
    return tuple(lines)


def outcome(part: RolloutPart) -> RolloutOutcome:
    """How a rollout ended: contact, off the road, cut; or why there is none."""
    if not isinstance(part.rollout, Rollout):
        return RolloutOutcome(why_missing(part.rollout), "bad")
    curves = series(part.rollout)
    words: list[str] = []
    hit = curves.collision_step
    if hit is not None:
        words.append(f"contact at {curves.time[hit]:.1f} s")
    if not isinstance(part.metrics, NotMade) and part.metrics.drivable.first_step is not None:
        words.append(f"off the road at {part.metrics.drivable.first_step * part.rollout.dt:.1f} s")
    tone: Tone = "bad" if words else "good"
    if hit is None:
        words.insert(0, f"no contact, smallest gap {curves.gap.min():.1f} m")
    if part.rollout.cut_reason is not None:
        words.append(f"cut at {curves.time[-1]:.1f} s")
    return RolloutOutcome("; ".join(words), tone, None if part.trust is None else part.trust.value)


def _contacts(scenarios: Sequence[ScenarioPart], arm: str) -> str:
    parts = [part for one in scenarios for part in one.rollouts if part.arm == arm]
    scored = [part.metrics for part in parts if not isinstance(part.metrics, NotMade)]
    if not scored:
        return "not scored"
    told = f"{sum(one.collision.nc.value == 1.0 for one in scored)} of {len(scored)}"
    cut = sum(one.cut_reason is not None for one in scored)
    failed = sum(isinstance(part.rollout, RolloutFailure) for part in parts)
    counts = {"cut short": cut, "failed": failed}
    notes = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
    return f"{told} ({notes})" if notes else told


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
            "The ego drove exactly alike with all arms: the images made no difference to this "
            "planner, or in this scenario."
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
    return f"Distance of the ego from its path with the truth: {'; '.join(told)}."


def same_endings(
    run: ReportInputs, scenarios: Sequence[ScenarioPart], truth: str
) -> tuple[str, ...]:
    """In how many scenarios each arm ended as the truth did, contact or none.

    Where one of the two rollouts was cut, both are looked at up to there.
    """
    told = []
    for arm, title in run.arms.items():
        pairs = [
            metrics[arm].same_verdict(metrics[truth])
            for scenario in scenarios
            if {arm, truth} <= (metrics := scored(scenario)).keys()
        ]
        if arm != truth and pairs:
            told.append(f"{sum(pairs)} of {len(pairs)} with {vehicles([title])}")
    return (
        (f"Scenarios with the true verdict (collision or not): {', '.join(told)}.",) if told else ()
    )


def scored(scenario: ScenarioPart) -> dict[str, RolloutMetrics]:
    """The metrics of its rollouts that have some, by arm."""
    return {
        part.arm: part.metrics
        for part in scenario.rollouts
        if not isinstance(part.metrics, NotMade)
    }


def listed(names: Sequence[str]) -> str:
    """Names as in a sentence: a, a and b, a, b and c."""
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]


def vehicles(labels: Sequence[str]) -> str:
    """One or more labels of arms as in a sentence: "the replaced and the true vehicle"."""
    noun = f" {labels[0].rpartition(' ')[2]}"
    if noun[1:] not in (ANY_VEHICLE, *PEOPLE) or not all(label.endswith(noun) for label in labels):
        return listed(list(labels))
    return listed([f"the {label.removesuffix(noun)}" for label in labels]) + noun


@dataclass(frozen=True)
class CoverageLine:
    """One rollout.

    Attributes:
        anchor: number of that scenario on the page.
        planned: whether it is about the planner's images; else about all that were recorded.
    """

    title: str
    anchor: int
    arm: str
    planned: bool
    mean: Coverage
    visible: int
    images: int


def looked_at(coverage: RolloutCoverage) -> RolloutCoverage:
    """The images that the planner was given; all for a planner that looks at none."""
    return coverage.of_planner or coverage


def coverage_lines(
    scenarios: Sequence[ScenarioPart], arms: Mapping[str, str]
) -> tuple[CoverageLine, ...]:
    """A line for each rollout whose vehicle has shares, by scenario, then as they are given."""
    return tuple(
        CoverageLine(
            title=scenario.title,
            anchor=number,
            arm=arms[part.arm],
            planned=part.coverage.of_planner is not None,
            mean=looked_at(part.coverage).mean,
            visible=looked_at(part.coverage).visible,
            images=len(looked_at(part.coverage).images),
        )
        for number, scenario in enumerate(scenarios, 1)
        for part in scenario.rollouts
        if part.coverage is not None
    )


def coverage_note(line: CoverageLine) -> str:
    """The line as a sentence."""
    who = "the planner saw" if line.planned else "the cameras showed"
    if line.visible == 0:
        return f"None of the {line.images} images that {who} shows the {line.arm}."
    mean = line.mean
    return (
        f"Of the {line.arm} that {who}, {mean.invented:.0%} was invented, "
        f"{mean.mirrored:.0%} mirrored and {mean.seen:.0%} seen in the log "
        f"(visible in {line.visible} of {line.images} images)."
    )


def trust_figure(value: float) -> str:
    """Trust in two digits; no calibration on some hundred rollouts tells 0.99 from certainty."""
    return "over 0.99" if value > 0.99 else f"{value:.2f}"


def trust_note(part: RolloutPart, arms: Mapping[str, str]) -> str:
    """How far to trust the verdict of a rollout that was judged."""
    assert part.trust is not None
    return f"Trust in the verdict with the {arms[part.arm]}: {trust_figure(part.trust.value)}. " + (
        part.trust.words
    )


@dataclass(frozen=True)
class Check:
    """One reason to trust the results, or not: what, the value found, the value wanted."""

    name: str
    found: str
    wanted: str
    tone: Tone


def checks(run: ReportInputs) -> tuple[Check, ...]:
    """What the results rest on, with limits where the run has set some."""
    found: list[Check] = []
    if isinstance(run.scene, ScenePart):
        for score in run.scene.scores:
            psnr = f"{score.psnr:.2f} dB"
            found.append(Check(f"Held-out PSNR, {score.region}", psnr, "", "plain"))
            if score.ssim is not None:
                ssim = f"{score.ssim:.3f}"
                found.append(Check(f"Held-out SSIM, {score.region}", ssim, "", "plain"))
    else:
        found.append(Check("Held-out images", "not evaluated", "", "warn"))
    registration = run.actor.registration if isinstance(run.actor, ActorPart) else None
    if isinstance(registration, RegistrationPart):
        good = registration.median_after <= registration.limit
        found.append(
            Check(
                "LiDAR to actor, median",
                f"{registration.median_after:.3f} m",
                f"at most {registration.limit:.2f} m",
                "good" if good else "bad",
            )
        )
    else:
        found.append(Check("Registration to the LiDAR", "not done", "", "warn"))
    if isinstance(run.truth, TruthPart):
        found.extend(_beyond_the_log(run.truth))
    if not isinstance(run.scenarios, NotMade):
        found.extend(_invented(coverage_lines(run.scenarios, run.arms)))
        found.extend(_gaps(run.scenarios))
        found.extend(_trust(run.scenarios))
    found += [_agreement(read_agreement(folder)) for folder in run.recording]
    if not isinstance(run.hd_map, NotMade):
        derived = run.hd_map.derived
        found.append(
            Check(
                "Map",
                "derived from the drive" if derived else "surveyed",
                "surveyed; with a derived map, DAC is approximate",
                "warn" if derived else "good",
            )
        )
    else:
        found.append(Check("Map", "none: DAC has no value", "", "warn"))
    if not isinstance(run.scenarios, NotMade):
        found.append(_completeness(run.scenarios))
    return tuple(found)


def _beyond_the_log(truth: TruthPart) -> tuple[Check, ...]:
    beyond = truth.views.beyond_60
    if beyond.baseline is None or beyond.candidate is None:
        return ()
    found = []
    own, made = truth.names["baseline"], truth.names["candidate"]
    for label, before, after, digits, unit in (
        ("Mask IoU", beyond.baseline.mask_iou, beyond.candidate.mask_iou, 2, ""),
        ("PSNR", beyond.baseline.psnr, beyond.candidate.psnr, 1, " dB"),
    ):
        text = f"{own} {before:.{digits}f}{unit}, {made} {after:.{digits}f}{unit}"
        wanted = f"the {made} nearer to the truth"
        tone: Tone = "good" if after > before else "bad"
        found.append(Check(f"{label}, 60° and more from the log", text, wanted, tone))
    return tuple(found)


def _invented(lines: Sequence[CoverageLine]) -> tuple[Check, ...]:
    """Between which shares of the vehicle, of all that was shown of it, nobody had seen."""
    shares = [line.mean.invented for line in lines if line.visible]
    if not shares:
        return ()
    text = f"{min(shares):.0%}"
    if len(shares) > 1:
        text += f" to {max(shares):.0%} by rollout"
    return (Check("Invented share of the visible actor", text, "little; see Actor", "plain"),)


AS_ONE_PIXEL = 1.2
"""Up to this many times what one pixel moves, a planner sees in a rendering what was recorded."""


def _agreement(found: PlanAgreement) -> Check:
    """How many plans are others than on the recorded images: for any planner, on this log."""
    moved = {arm: scores.moved for arm in found.arms if (scores := found.scores(arm)) is not None}
    shown = ", ".join(f"{arm} {share:.0%}" for arm, share in moved.items())
    text = f"{shown}; shifted by one pixel {found.floor:.0%}"
    good = max(moved.values()) <= AS_ONE_PIXEL * found.floor
    wanted = f"up to {AS_ONE_PIXEL:g} times one pixel; see Against the recording"
    name = f"Plans more than {MOVED:g} m off those on the recorded images, {found.planner}"
    return Check(name, text, wanted, "good" if good else "warn")


FEW_GAPS, MANY_GAPS = 0.02, 0.1
"""Shares of the planner's images, at the worst moment, up to which gaps are few, and from which on
they are many. By eye; what they do to verdicts is not measured."""


def _gaps(scenarios: Sequence[ScenarioPart]) -> tuple[Check, ...]:
    """The largest share of the planner's images that the log does not show."""
    shown = [p.gaps for one in scenarios for p in one.rollouts if p.gaps is not None]
    if not shown:
        return ()
    one = max(shown, key=lambda gaps: gaps.worst.invented + gaps.worst.empty)
    share = one.worst.invented + one.worst.empty
    text = f"{share:.1%} ({one.worst.empty:.1%} empty), {one.worst_s:.1f} s after the start"
    tone: Tone = "good" if share <= FEW_GAPS else "warn" if share < MANY_GAPS else "bad"
    wanted = f"up to {FEW_GAPS:.0%}; where the ego leaves its recorded line, there is more"
    return (Check("Street that no image shows, at most", text, wanted, tone),)


def _trust(scenarios: Sequence[ScenarioPart]) -> tuple[Check, ...]:
    """Between which values the trust in the verdicts lies."""
    trusts = [p.trust for one in scenarios for p in one.rollouts if p.trust is not None]
    if not trusts:
        return ()
    values = [one.value for one in trusts]
    text = trust_figure(min(values))
    if len(values) > 1:
        text += f" to {trust_figure(max(values))} by rollout"
    wanted = "near 1; see Rollouts"
    if any(one.provisional for one in trusts):
        wanted += ". The calibration is provisional"
    return (Check("Trust in the verdicts", text, wanted, "plain"),)


def _completeness(scenarios: Sequence[ScenarioPart]) -> Check:
    parts = [part.rollout for scenario in scenarios for part in scenario.rollouts]
    rollouts = [r for r in parts if isinstance(r, Rollout)]
    whole = sum(r.cut_reason is None for r in rollouts)
    failed = sum(isinstance(r, RolloutFailure) for r in parts)
    text = f"{whole} of {len(parts)} ran their full length"
    text += f", {failed} failed" if failed else ""
    tone: Tone = "good" if whole == len(parts) else "bad" if failed else "warn"
    return Check("Rollouts", text, "all; a rollout that was cut has fewer chances to fail", tone)
