"""Reading metrics.json back, checked."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, field_validator

from recast import storage
from recast.evaluation import COLUMNS
from recast.records import parse_record

METRICS_VERSION: Literal[2] = 2
"""1 had no `com_driven`, and compared rollouts of different lengths as they were."""


class _Open(BaseModel):
    """Members that nobody here reads may be anything."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)


class _Row(_Open):
    method: str
    asked: int
    rollouts: int
    failed: int
    cut: int
    plans: int
    means: dict[str, float | None]
    counts: dict[str, int]

    @field_validator("means")
    @classmethod
    def _all_headlines(cls, value: dict[str, float | None]) -> dict[str, float | None]:
        missing = [name for name, one in COLUMNS.items() if one.headline and name not in value]
        if missing:
            raise ValueError(f"lacks {', '.join(missing)}")
        return value


class _Scored(_Open):
    motion: str
    setting: str
    method: str


class _Failed(_Scored):
    name: str
    error: str
    reason: str


class _Metrics(_Open):
    table: list[_Row]
    rollouts: list[_Scored]
    failures: list[_Failed]


def read_metrics(path: Path) -> dict[str, Any]:
    """The contents of metrics.json, as JSON says them.

    Raises:
        InputError: it is missing or damaged.
    """
    value: dict[str, Any] = storage.read_json(path)
    parse_record(path, value, _Metrics, METRICS_VERSION, "remove it and run again")
    return value
