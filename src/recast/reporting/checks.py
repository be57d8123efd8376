"""Whether to trust a run: its checks, and what of the vehicle its cameras showed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from recast.actors.coverage import Coverage
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
from recast.reporting.tables import Tone
from recast.simulation.coverage import RolloutCoverage
from recast.simulation.rollout import Rollout, RolloutFailure


@dataclass(frozen=True)
class CoverageLine:
    """One rollout.

    Attributes:
        title: title of its scenario.
        anchor: number of that scenario on the page.
        planned: whether it is about the planner's images; else about all that were recorded.
        mean: mean coverage over the images.
        visible: number of images that show the vehicle.
        images: number of images.
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


def trust_note(part: RolloutPart, arms: Mapping[str, str]) -> str:
    """How far to trust the verdict of a rollout that was judged."""
    assert part.trust is not None
    return f"Trust in the verdict with the {arms[part.arm]}: {part.trust.value:.2f}. " + (
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
        found.extend(_trust(run.scenarios))
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


def _trust(scenarios: Sequence[ScenarioPart]) -> tuple[Check, ...]:
    """Between which values the trust in the verdicts lies."""
    trusts = [p.trust for one in scenarios for p in one.rollouts if p.trust is not None]
    if not trusts:
        return ()
    values = [one.value for one in trusts]
    text = f"{min(values):.2f}"
    if len(values) > 1:
        text += f" to {max(values):.2f} by rollout"
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


@dataclass(frozen=True)
class Glance:
    """Numbers for the first screen.

    Attributes:
        counts: how many checks are good, bad, and need care.
        coverage: coverage of the vehicle over all images of all rollouts; None without shares.
    """

    counts: tuple[tuple[str, int], ...]
    coverage: Coverage | None


def glance(run: ReportInputs, checks: Sequence[Check]) -> Glance:
    """Count the checks, and gather the coverage of all rollouts."""
    tones = [check.tone for check in checks]
    parts = () if isinstance(run.scenarios, NotMade) else run.scenarios
    images = [
        image.coverage
        for scenario in parts
        for part in scenario.rollouts
        if part.coverage is not None
        for image in looked_at(part.coverage).images
    ]
    mean = Coverage.mean(images)
    return Glance(
        counts=tuple((tone, tones.count(tone)) for tone in ("good", "bad", "warn")),
        coverage=mean if mean.pixels > 0 else None,
    )
