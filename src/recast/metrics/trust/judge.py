"""The trust of one rollout, and why it is what it is, in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from recast.metrics.trust.calibration import TrustCalibration
from recast.metrics.trust.features import FEATURES, TrustFeatures

_LEAST_EFFECT = 0.2
"""Log-odds by which a feature must lower the trust to be told as a reason: 5 points at most."""
_VEHICLE = ("seen", "mirrored", "invented", "without_shares", "view_angle_deg")


@dataclass(frozen=True)
class RolloutTrust:
    """How far to trust the verdict of a rollout, collision or not.

    Attributes:
        value: the chance that the true world gives the same verdict, 0 to 1.
        words: the same for people, with reasons and steps.
        steps: what happens at the steps that carry the verdict, by step, in order.
        features: features of the rollout; None for a planner that looks at no images.
        provisional: whether the calibration comes from few scenes.
    """

    value: float
    words: str
    steps: Mapping[int, str]
    features: TrustFeatures | None
    provisional: bool

    def to_json(self) -> dict[str, Any]:
        """Plain data; a feature that is not known is null, and `missing` says why."""
        values = None if self.features is None else self.features.values
        return {
            "value": self.value,
            "words": self.words,
            "steps": [{"step": step, "what": what} for step, what in self.steps.items()],
            "features": None if values is None else {name: values.get(name) for name in FEATURES},
            "missing": {} if self.features is None else dict(self.features.missing),
            "provisional": self.provisional,
        }


SIGHTLESS = RolloutTrust(
    1.0,
    "The planner uses no images, so the verdict does not depend on how the street and the "
    "vehicle look.",
    {},
    None,
    False,
)
"""Of a rollout whose planner is given no image."""


def judge(features: TrustFeatures, calibration: TrustCalibration) -> RolloutTrust:
    """The trust of a rollout by a calibration."""
    model = calibration.model
    value = model.trust(features.values)
    steps = _steps(features)
    told = [
        f"{_of_ten(value)} verdicts like this one are right: {_vehicle(features)}.",
        f"The verdict rests on "
        f"{' and '.join(f'step {step} ({what})' for step, what in steps.items())}.",
    ]
    lowering = [
        name
        for name, part in sorted(model.parts(features.values).items(), key=lambda one: one[1])
        if part <= -_LEAST_EFFECT and name not in _VEHICLE
    ]
    if lowering:
        name = lowering[0]
        told.append(f"The main reason for doubt: {_told(name, features.values[name])}.")
    reasons = dict.fromkeys(
        reason for name, reason in features.missing.items() if name not in _EXPECTED
    )
    if reasons:
        told.append(f"Not known: {'; '.join(reasons)}.")
    if calibration.provisional:
        told.append(f"The calibration is provisional ({len(calibration.data.scenes)} scenes).")
    return RolloutTrust(value, " ".join(told), steps, features, calibration.provisional)


_EXPECTED = ("least_ttc_s", "plan_change_m", "noise_flips")
"""Features whose absence only says what kind of rollout or run it is."""


def _of_ten(value: float) -> str:
    """In tenths; none is certain."""
    if value >= 0.95:
        return "More than 9 of 10"
    return "Fewer than 1 of 10" if value < 0.05 else f"About {round(10 * value)} of 10"


def _vehicle(features: TrustFeatures) -> str:
    """How the plan that mattered saw the vehicle."""
    where = f"at the plan that mattered (step {features.changed})"
    view, coverage = features.view, features.coverage
    if view is None:
        return f"{where} no camera showed the vehicle"
    told = f"{where} the vehicle was seen from its {view.side}"
    if coverage is not None and coverage.pixels > 0:
        return f"{told} ({coverage.invented:.0%} invented, {coverage.mirrored:.0%} mirrored)"
    if view.angle is not None:
        return f"{told} ({view.angle:.0f}° from the nearest view in the log)"
    return f"{told}, which the log never shows well"


def _steps(features: TrustFeatures) -> dict[int, str]:
    """By step, in order."""
    change, margin = features.values.get("plan_change_m"), features.values["margin_m"]
    changed = "the first plan" if change is None else f"the plan changed by {change:.1f} m"
    if features.values["collision"]:
        closest = f"contact, {margin:.1f} m deep"
    else:
        closest = f"smallest gap, {margin:.1f} m"
    if features.changed == features.closest:
        return {features.changed: f"{changed}; {closest}"}
    return dict(sorted({features.changed: changed, features.closest: closest}.items()))


def _told(name: str, value: float) -> str:
    """A feature with its value."""
    if name == "collision":
        return "the verdict is a collision" if value else "the verdict is no collision"
    digits = 2 if name in ("held_out_ssim", "noise_flips") else 1
    return f"{FEATURES[name].what}, {value:.{digits}f}"
