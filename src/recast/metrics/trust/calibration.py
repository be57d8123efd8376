"""A calibration of the trust figure: its coefficients, the data that they come from, on disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from recast.core import files
from recast.core.errors import InputError
from recast.core.records import Record, read_record
from recast.metrics.trust.features import FEATURES
from recast.metrics.trust.model import READ, RIDGE, TrustModel
from recast.metrics.trust.reliability import (
    JudgedRollout,
    Reliability,
    fit_rollouts,
    reliability,
    trust_left_out,
)

FORMAT: Literal["recast-trust"] = "recast-trust"
VERSION: Literal[2] = 2
MEASURED_SCENES = 20
"""A calibration on fewer scenes is provisional."""
_MEND = "make it again with `recast bench trust`"
_Share = Annotated[float, Field(ge=0, le=1)]


class CalibratedFeature(Record):
    """A feature in the model; `known` is the number of rollouts that have it."""

    name: str
    coefficient: float
    mean: float
    scale: float = Field(gt=0)
    known: int = Field(ge=0)


class CalibrationBin(Record):
    """See `ReliabilityBin`."""

    low: _Share
    high: _Share
    count: int = Field(ge=0)
    trust: _Share | None
    agreeing: _Share | None


class LeftOutScenes(Record):
    """See `Reliability`; each scene is judged by a model that was fitted without it."""

    scenes: int = Field(ge=2)
    rollouts: int = Field(ge=1)
    agreeing: int = Field(ge=0)
    auc: _Share | None
    verdict_auc: _Share | None
    brier: _Share
    base_brier: _Share
    bins: tuple[CalibrationBin, ...]


class CalibrationData(Record):
    """The rollouts of a calibration; `agreeing` of them have the verdict of the truth."""

    grids: tuple[str, ...]
    scenes: tuple[str, ...]
    planners: tuple[str, ...]
    arms: tuple[str, ...]
    rollouts: int = Field(ge=1)
    agreeing: int = Field(ge=0)


class TrustCalibration(Record):
    """What turns the features of a rollout into its trust; see docs/trust.md."""

    format: Literal["recast-trust"] = FORMAT
    version: Literal[2] = VERSION
    intercept: float
    ridge: float = Field(gt=0)
    features: tuple[CalibratedFeature, ...]
    data: CalibrationData
    left_out: LeftOutScenes

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
        left_out=LeftOutScenes.model_validate(asdict(found)),
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
