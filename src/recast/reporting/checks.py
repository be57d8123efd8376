"""Whether to trust a run: what its results rest on, against the limits it has set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from recast.reporting.coverage_view import CoverageLine, coverage_lines
from recast.reporting.inputs import (
    ActorPart,
    NotMade,
    RegistrationPart,
    ReportInputs,
    ScenarioPart,
    ScenePart,
)
from recast.reporting.tables import Tone
from recast.reporting.truth_inputs import TruthPart
from recast.simulation.rollout import Rollout, RolloutFailure


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
            found.append(
                _at_least(f"Held-out PSNR, {score.region}", score.psnr, score.psnr_limit, "dB", 2)
            )
            if score.ssim is not None:
                found.append(
                    _at_least(f"Held-out SSIM, {score.region}", score.ssim, score.ssim_limit, "", 3)
                )
    else:
        found.append(Check("Held-out images", "not made", "", "warn"))
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
        found.append(Check("Registration to the LiDAR", "not made", "", "warn"))
    if isinstance(run.truth, TruthPart):
        found.extend(_beyond_the_log(run.truth))
    if not isinstance(run.scenarios, NotMade):
        found.extend(_invented(coverage_lines(run.scenarios, run.arms)))
    if not isinstance(run.hd_map, NotMade):
        derived = run.hd_map.derived
        found.append(
            Check(
                "Map",
                "derived from the drive" if derived else "surveyed",
                "surveyed; a derived one makes DAC approximate",
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
    return (Check("Invented, of what was shown of the actor", text, "little; see Actor", "plain"),)


def _completeness(scenarios: Sequence[ScenarioPart]) -> Check:
    parts = [part.rollout for scenario in scenarios for part in scenario.rollouts]
    rollouts = [r for r in parts if isinstance(r, Rollout)]
    whole = sum(r.cut_reason is None for r in rollouts)
    failed = sum(isinstance(r, RolloutFailure) for r in parts)
    text = f"{whole} of {len(parts)} ran their full length"
    text += f", {failed} failed" if failed else ""
    tone: Tone = "good" if whole == len(parts) else "bad" if failed else "warn"
    return Check("Rollouts", text, "all; a cut one has fewer chances to fail", tone)


def _at_least(name: str, value: float, limit: float | None, unit: str, digits: int) -> Check:
    unit = f" {unit}" if unit else ""
    if limit is None:
        return Check(name, f"{value:.{digits}f}{unit}", "", "plain")
    tone: Tone = "good" if value >= limit else "bad"
    return Check(name, f"{value:.{digits}f}{unit}", f"at least {limit:g}{unit}", tone)
