"""What a sampling run can be told, and the times it visits."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, field_validator

from recast.errors import InputError
from recast.records import Record, validation_error

PUBLISHED_SAMPLER = "FlowEulerGuidanceIntervalSampler"
PUBLISHED_PARAMS = ("steps", "cfg_strength", "cfg_interval", "rescale_t")
PUBLISHED_ARGS = ("sigma_min",)

Time = Annotated[float, Field(ge=0, le=1, strict=True)]


class SamplerSettings(Record):
    """Settings of `sample`; the defaults are those of the published TRELLIS checkpoints.

    Attributes:
        steps: of Euler's method.
        cfg_strength: s of classifier-free guidance, (1 + s) v(cond) - s v(zeros); 0 is none.
        cfg_interval: first and last time t, both included, at which guidance acts (Kynkäänniemi et
            al. 2024). t is 1 for noise and 0 for data, after rescaling.
        rescale_t: r in t' = r t / (1 + (r - 1) t); above 1 more of the steps go to noisy times.
        sigma_min: noise left at t = 0.
    """

    steps: int = Field(default=25, ge=1, le=1000, strict=True)
    cfg_strength: float = Field(default=5.0, ge=0, le=1000, strict=True)
    cfg_interval: tuple[Time, Time] = (0.5, 1.0)
    rescale_t: float = Field(default=3.0, gt=0, le=1000, strict=True)
    sigma_min: float = Field(default=1e-5, ge=0, lt=1, strict=True)

    @field_validator("cfg_interval")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] > value[1]:
            raise ValueError("begins after its end")
        return value

    def merged(self, **overrides: Any) -> Self:
        """These settings with some replaced; an override of None leaves the value as it is.

        Raises:
            InputError: an unknown name, or a value out of its range.
        """
        given = {name: value for name, value in overrides.items() if value is not None}
        return self._checked({**self.model_dump(), **given}, "sampler settings")

    @classmethod
    def from_published(cls, record: Mapping[str, Any], where: str | Path) -> Self:
        """Read one sampler of a `pipeline.json`: {"name", "args": {..}, "params": {..}}.

        Nothing is filled in: the published code has other defaults than its checkpoints.

        Args:
            record: its `params` hold steps, cfg_strength, cfg_interval and rescale_t, its `args`
                sigma_min.
            where: the file, for the error message.

        Raises:
            InputError: another sampler class, a missing or unknown name, a value out of its range.
        """
        mend = "use a pipeline.json in the published layout"
        name = record.get("name")
        if name != PUBLISHED_SAMPLER:
            raise InputError(where, "name", f"is {name!r}, not {PUBLISHED_SAMPLER}", mend)
        values: dict[str, Any] = {}
        for part, expected in (("args", PUBLISHED_ARGS), ("params", PUBLISHED_PARAMS)):
            members = record.get(part)
            if not isinstance(members, Mapping):
                raise InputError(where, part, "is missing or no object", mend)
            wrong = set(expected) ^ set(members)
            if wrong:
                first = min(wrong)
                problem = "is missing" if first in expected else "is unknown"
                raise InputError(where, f"{part}.{first}", problem, mend)
            values.update(members)
        return cls._checked(values, where)

    def published(self) -> dict[str, Any]:
        """The record that `from_published` reads."""
        params: dict[str, Any] = {name: getattr(self, name) for name in PUBLISHED_PARAMS}
        params["cfg_interval"] = list(self.cfg_interval)
        return {
            "name": PUBLISHED_SAMPLER,
            "args": {"sigma_min": self.sigma_min},
            "params": params,
        }

    @classmethod
    def _checked(cls, values: Mapping[str, Any], where: str | Path) -> Self:
        try:
            return cls.model_validate(values)
        except ValidationError as error:
            raise validation_error(where, error, "correct the sampler setting") from None

    def guided(self, t: float) -> bool:
        """Whether guidance acts at time t."""
        low, high = self.cfg_interval
        return self.cfg_strength > 0 and low <= t <= high


def time_steps(settings: SamplerSettings) -> NDArray[np.float64]:
    """Times (steps + 1,) from exactly 1 (noise) down to exactly 0 (data), strictly decreasing.

    t = r u / (1 + (r - 1) u) for u evenly spaced (Esser et al. 2024, section 5.3.2).
    """
    r = settings.rescale_t
    even = np.linspace(1.0, 0.0, settings.steps + 1)
    times = r * even / (1 + (r - 1) * even)
    times[0] = 1.0  # rounding may leave it above 1, and so outside the guidance interval
    return times
