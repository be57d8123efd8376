"""The model of the trust figure: its fit, its calibration on disk, and the trust of one rollout.

`reliability` says how far the figure can be trusted: by bins, ROC curve, Brier score."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator
from scipy.optimize import minimize
from scipy.special import expit

from recast.arrays import Array
from recast.core import files
from recast.core.errors import InputError
from recast.core.records import Record, read_record
from recast.metrics.trust.features import FEATURES, TrustFeatures

READ = tuple(name for name, feature in FEATURES.items() if feature.sign is not None)
"""Features that the model reads, in the order of its coefficients."""
RIDGE = 1.0
"""Weight of the squared coefficients against one rollout's loss."""
_INTERCEPT_RIDGE = 0.01
"""Keeps the intercept finite where all verdicts are alike; elsewhere it changes little."""
MOST_DEVIATIONS = 3.0
"""Standardised features end here, so that no single one far from all data decides."""


@dataclass(frozen=True)
class TrustModel:
    """Coefficients (F,) of standardised features, and how these are standardised.

    Attributes:
        means, scales: (F,) means and scales of the features in the data, after the logarithm of
            those that have one.
    """

    intercept: float
    coefficients: Array
    means: Array
    scales: Array

    def standardised(self, values: Mapping[str, float]) -> Array:
        """(F,) features less their means, in units of their scales; 0 for one that is missing."""
        return _within((_row(values) - self.means) / self.scales)

    def parts(self, values: Mapping[str, float]) -> dict[str, float]:
        """What each feature adds to the log-odds, against its mean; 0 for one that is missing."""
        added = (self.coefficients * self.standardised(values)).tolist()
        return dict(zip(READ, added, strict=True))

    def trust(self, values: Mapping[str, float]) -> float:
        """The chance that the verdict is right, 0 to 1."""
        return float(expit(self.intercept + sum(self.parts(values).values())))


def fit_model(
    features: Sequence[Mapping[str, float]], agrees: ArrayLike, ridge: float = RIDGE
) -> TrustModel:
    """The model of rollouts whose verdicts are known to be right or wrong.

    Minimises the sum of log losses plus half `ridge` times the squared coefficients of standardised
    features. Each coefficient has the sign of its feature, or is zero.

    Args:
        features: features of N rollouts, by name; a missing one counts as the mean of the others.
        agrees: (N,) bool, whether each verdict is right.

    Raises:
        ValueError: no rollout.
    """
    labels = np.asarray(agrees, np.float64)
    if len(features) == 0 or labels.shape != (len(features),):
        raise ValueError(f"fit_model: {len(features)} rollouts, but labels of shape {labels.shape}")
    raw = np.stack([_row(values) for values in features])
    known = np.isfinite(raw)
    count = np.maximum(known.sum(axis=0), 1)
    means = np.where(known, raw, 0.0).sum(axis=0) / count
    deviations = np.where(known, raw - means, 0.0)
    scales = np.sqrt((deviations**2).sum(axis=0) / count)
    # A feature that never changes tells nothing; rounding leaves it a scale of its own size.
    constant = scales <= 1e-9 * np.maximum(np.abs(means), 1.0)
    scales = np.where(constant, 1.0, scales)
    table = np.where(constant, 0.0, _within(deviations / scales))
    bounds = [(None, None), *(_BOUNDS[FEATURES[name].sign or 0] for name in READ)]
    found = minimize(
        lambda at: loss(at, table, labels, ridge),
        np.zeros(1 + len(READ)),
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": 1000, "ftol": 1e-14, "gtol": 1e-9},
    )
    return TrustModel(float(found.x[0]), np.asarray(found.x[1:]), means, scales)


def loss(at: Array, table: Array, labels: Array, ridge: float) -> tuple[float, Array]:
    """The regularised log loss and its gradient (1 + F,).

    Args:
        at: (1 + F,) intercept and coefficients.
        table: (N, F) standardised features.
        labels: (N,) 0 or 1.
    """
    weights = np.concatenate([[_INTERCEPT_RIDGE], np.full(len(at) - 1, ridge)])
    odds = at[0] + table @ at[1:]
    value = np.sum(np.logaddexp(0.0, odds) - labels * odds) + 0.5 * float(weights @ at**2)
    wrong = expit(odds) - labels
    return float(value), np.concatenate([[wrong.sum()], wrong @ table]) + weights * at


_BOUNDS: Mapping[int, tuple[float | None, float | None]] = {
    -1: (None, 0.0),
    0: (None, None),
    1: (0.0, None),
}


def _row(values: Mapping[str, float]) -> Array:
    """(F,) features as the model reads them; NaN for one that is missing."""
    found = np.array([values.get(name, np.nan) for name in READ])
    logarithmic = np.array([FEATURES[name].logarithmic for name in READ])
    return np.where(logarithmic, np.log1p(np.where(logarithmic, found, 0.0)), found)


def _within(standardised: NDArray[np.float64]) -> Array:
    known = np.where(np.isfinite(standardised), standardised, 0.0)
    return np.clip(known, -MOST_DEVIATIONS, MOST_DEVIATIONS)


BINS = 5
"""Bins of equal width from 0 to 1."""


@dataclass(frozen=True)
class JudgedRollout:
    """A rollout whose verdict was compared with the truth.

    Attributes:
        scene: its id; rollouts of one scene are alike.
        scenario: motion and setting of the actor.
        planner, arm: the rollout's fields of the same names, see `Rollout`.
        features: features by name, see `recast.metrics.trust.FEATURES`.
        agrees: whether its verdict is that of the truth.
    """

    scene: str
    scenario: str
    planner: str
    arm: str
    features: Mapping[str, float]
    agrees: bool


_Share = Annotated[float, Field(ge=0, le=1)]


class ReliabilityBin(Record):
    """Rollouts whose trust lies from `low` up to `high`; the last bin includes 1.

    Attributes:
        trust: their mean trust; None without a rollout.
        agreeing: share of them whose verdict is right; None without a rollout.
    """

    low: _Share
    high: _Share
    count: int = Field(ge=0)
    trust: _Share | None
    agreeing: _Share | None


class Reliability(Record):
    """How trust and truth go together.

    Attributes:
        auc: area under the ROC curve: the chance that of a right and a wrong verdict the right one
            has the greater trust; None if all are right, or all wrong.
        verdict_auc: the same of a figure that looks at the verdict alone, collision or not.
        collisions, agreeing_collisions: rollouts that collide, and those of them that do so in the
            true world.
        collision_auc: `auc` among those that collide, where the verdict alone has 0.5.
        brier: mean squared difference between trust and truth (1 right, 0 wrong).
        base_brier: the same of a figure that gives every rollout the share of right verdicts.
    """

    scenes: int = Field(ge=1)
    rollouts: int = Field(ge=1)
    agreeing: int = Field(ge=0)
    auc: _Share | None
    verdict_auc: _Share | None
    collisions: int = Field(ge=0)
    agreeing_collisions: int = Field(ge=0)
    collision_auc: _Share | None
    brier: _Share
    base_brier: _Share
    bins: tuple[ReliabilityBin, ...]


def area_under_roc(trust: ArrayLike, agrees: ArrayLike) -> float | None:
    """Area under the ROC curve of N rollouts, equal ones counted half; see `Reliability.auc`.

    Args:
        trust: (N,) trust in each rollout, 0 to 1.
        agrees: (N,) bool, whether each verdict is right.
    """
    given, right = np.asarray(trust, np.float64), np.asarray(agrees, np.bool_)
    good, bad = given[right], np.sort(given[~right])
    if len(good) == 0 or len(bad) == 0:
        return None
    below = np.searchsorted(bad, good, "left") + np.searchsorted(bad, good, "right")
    return float(below.mean() / (2 * len(bad)))


def reliability(rollouts: Sequence[JudgedRollout], trust: ArrayLike) -> Reliability:
    """Compare the trust (N,) of N rollouts, at least one, with the truth."""
    given = np.asarray(trust, np.float64)
    right = np.array([one.agrees for one in rollouts], np.bool_)
    edges = np.linspace(0.0, 1.0, BINS + 1)
    place = np.minimum((given * BINS).astype(np.int64), BINS - 1)
    bins = []
    for i in range(BINS):
        inside = place == i
        known = bool(inside.any())
        bins.append(
            ReliabilityBin(
                low=float(edges[i]),
                high=float(edges[i + 1]),
                count=int(inside.sum()),
                trust=float(given[inside].mean()) if known else None,
                agreeing=float(right[inside].mean()) if known else None,
            )
        )
    share = float(right.mean())
    collides = np.array([one.features["collision"] for one in rollouts], np.bool_)
    alone = area_under_roc(collides, right)
    return Reliability(
        scenes=len({one.scene for one in rollouts}),
        rollouts=len(rollouts),
        agreeing=int(right.sum()),
        auc=area_under_roc(given, right),
        verdict_auc=None if alone is None else max(alone, 1.0 - alone),
        collisions=int(collides.sum()),
        agreeing_collisions=int((collides & right).sum()),
        collision_auc=area_under_roc(given[collides], right[collides]),
        brier=float(np.mean((given - right) ** 2)),
        base_brier=share * (1 - share),
        bins=tuple(bins),
    )


def trust_left_out(rollouts: Sequence[JudgedRollout], ridge: float = RIDGE) -> Array:
    """Trust (N,) of each rollout by a model that was fitted without any rollout of its scene.

    Raises:
        ValueError: fewer than two scenes.
    """
    scenes = dict.fromkeys(one.scene for one in rollouts)
    if len(scenes) < 2:
        raise ValueError(f"trust_left_out: {len(scenes)} scenes, expected at least 2")
    found = np.zeros(len(rollouts))
    for scene in scenes:
        model = fit_rollouts([one for one in rollouts if one.scene != scene], ridge)
        for i, one in enumerate(rollouts):
            if one.scene == scene:
                found[i] = model.trust(one.features)
    return found


def fit_rollouts(rollouts: Sequence[JudgedRollout], ridge: float = RIDGE) -> TrustModel:
    """The model of some rollouts; see `fit_model`."""
    return fit_model([one.features for one in rollouts], [one.agrees for one in rollouts], ridge)


FORMAT: Literal["recast-trust"] = "recast-trust"
VERSION: Literal[3] = 3
MEASURED_SCENES = 20
"""A calibration on fewer scenes is provisional."""
_MEND = "make it again with `recast bench trust`"


class CalibratedFeature(Record):
    """A feature in the model; `known` is the number of rollouts that have it."""

    name: str
    coefficient: float
    mean: float
    scale: float = Field(gt=0)
    known: int = Field(ge=0)


class CalibrationData(Record):
    """The rollouts of a calibration; `agreeing` of them have the verdict of the truth."""

    grids: tuple[str, ...]
    scenes: tuple[str, ...]
    planners: tuple[str, ...]
    arms: tuple[str, ...]
    rollouts: int = Field(ge=1)
    agreeing: int = Field(ge=0)


class TrustCalibration(Record):
    """What turns the features of a rollout into its trust; see docs/trust.md.

    In `left_out`, each scene is judged by a model that was fitted without it.
    """

    format: Literal["recast-trust"] = FORMAT
    version: Literal[3] = VERSION
    intercept: float
    ridge: float = Field(gt=0)
    features: tuple[CalibratedFeature, ...]
    data: CalibrationData
    left_out: Reliability

    @model_validator(mode="after")
    def _fits(self) -> Self:
        names = tuple(one.name for one in self.features)
        if names != READ:
            raise ValueError(f"features: expected {', '.join(READ)}")
        for one in self.features:
            if one.coefficient * (FEATURES[one.name].sign or 0) < 0:
                raise ValueError(f"features: the coefficient of {one.name} has the wrong sign")
        return self

    @property
    def provisional(self) -> bool:
        """Whether it comes from too few scenes to be relied on."""
        return len(self.data.scenes) < MEASURED_SCENES

    @property
    def model(self) -> TrustModel:
        """The model of its coefficients."""
        columns = ("coefficient", "mean", "scale")
        values = np.array([[getattr(one, key) for key in columns] for one in self.features])
        return TrustModel(self.intercept, values[:, 0], values[:, 1], values[:, 2])


def calibrate(
    rollouts: Sequence[JudgedRollout], grids: Sequence[str], ridge: float = RIDGE
) -> tuple[TrustCalibration, Reliability]:
    """The calibration of rollouts whose verdicts were compared with the truth, and how it does.

    Args:
        grids: names of the grids that they come from.

    Returns:
        the calibration on all rollouts; the reliability by scenes left out in turn.

    Raises:
        InputError: fewer than two scenes, or all verdicts are right, or all are wrong.
    """
    scenes = tuple(dict.fromkeys(one.scene for one in rollouts))
    agreeing = sum(one.agrees for one in rollouts)
    if len(scenes) < 2:
        raise InputError(
            "GRIDS",
            "scenes",
            f"{len(scenes)} with a truth, at least 2 are needed",
            "give grids that have an oracle arm and, together, two or more scenes",
        )
    if agreeing in (0, len(rollouts)):
        problem = (
            f"is true for {agreeing} of {len(rollouts)} rollouts; both true and false are needed"
        )
        raise InputError("GRIDS", "verdict_agrees", problem, "give more grids")
    found = reliability(rollouts, trust_left_out(rollouts, ridge))
    model = fit_rollouts(rollouts, ridge)
    columns = zip(READ, model.coefficients, model.means, model.scales, strict=True)
    calibration = TrustCalibration(
        intercept=model.intercept,
        ridge=ridge,
        features=tuple(
            CalibratedFeature(
                name=name,
                coefficient=float(coefficient),
                mean=float(mean),
                scale=float(scale),
                known=sum(name in one.features for one in rollouts),
            )
            for name, coefficient, mean, scale in columns
        ),
        data=CalibrationData(
            grids=tuple(grids),
            scenes=scenes,
            planners=tuple(dict.fromkeys(one.planner for one in rollouts)),
            arms=tuple(dict.fromkeys(one.arm for one in rollouts)),
            rollouts=len(rollouts),
            agreeing=agreeing,
        ),
        left_out=found,
    )
    return calibration, found


def write_calibration(calibration: TrustCalibration, path: str | Path) -> None:
    """Write a calibration, whole or not at all.

    Raises:
        InputError: the disk refuses.
    """
    files.write_json(path, calibration.model_dump(mode="json"))


def read_calibration(path: str | Path) -> TrustCalibration:
    """Read back what `write_calibration` wrote.

    Raises:
        InputError: it is missing, damaged, or of features that this recast does not have.
    """
    return read_record(path, TrustCalibration, VERSION, _MEND, FORMAT)


@cache
def packaged_calibration() -> TrustCalibration:
    """The calibration that runs and reports use."""
    return read_calibration(Path(__file__).parent / "calibration.json")


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
    "target look.",
    {},
    None,
    False,
)
"""Trust of a rollout whose planner is given no image."""


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


_EXPECTED = ("gap_m", "contact_speed_mps", "least_ttc_s", "plan_change_m", "noise_flips")
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
        return f"{where} no camera showed the target"
    told = f"{where} the target was seen from its {view.side}"
    if coverage is not None and coverage.pixels > 0:
        return f"{told} ({coverage.invented:.0%} invented, {coverage.mirrored:.0%} mirrored)"
    if view.angle is not None:
        return f"{told} ({view.angle:.0f}° from the nearest view in the log)"
    return f"{told}, which the log never shows well"


def _steps(features: TrustFeatures) -> dict[int, str]:
    """By step, in order."""
    change = features.values.get("plan_change_m")
    changed = "the first plan" if change is None else f"the plan changed by {change:.1f} m"
    if features.values["collision"]:
        closest = f"contact at {features.values['contact_speed_mps']:.1f} m/s"
    else:
        closest = f"smallest gap, {features.values['gap_m']:.1f} m"
    if features.changed == features.closest:
        return {features.changed: f"{changed}; {closest}"}
    return dict(sorted({features.changed: changed, features.closest: closest}.items()))


def _told(name: str, value: float) -> str:
    """A feature with its value."""
    if name == "collision":
        return "the verdict is a collision" if value else "the verdict is no collision"
    digits = 2 if name in ("held_out_ssim", "noise_flips") else 1
    return f"{FEATURES[name].what}, {value:.{digits}f}"
