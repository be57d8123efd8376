"""Reading metrics.json and eval.json back, checked."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, field_validator

from recast import storage
from recast.evaluation import COLUMNS
from recast.records import parse_record
from recast.scene.evaluate_record import EVALUATION_VERSION

METRICS_VERSION: Literal[3] = 3
"""2 had one scene, one actor and one comparison with the truth."""


class _Open(BaseModel):
    """Members that nobody here reads may be anything."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)


class _Row(_Open):
    planner: str
    arm: str
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


class _Named(_Open):
    motion: str
    setting: str
    arm: str
    planner: str


class _Means(_Open):
    images: int
    visible: int
    pixels: float
    seen: float
    mirrored: float
    invented: float


class _Coverage(_Open):
    all: _Means
    planner: _Means | None


class _Scored(_Named):
    coverage: _Coverage | None = None


class _Failed(_Named):
    name: str
    error: str
    reason: str


class _Metrics(_Open):
    table: list[_Row]
    rollouts: list[_Scored]
    failures: list[_Failed]


class _Region(_Open):
    psnr: float
    ssim: float | None


class _Depth(_Open):
    median_abs_m: float
    mean_abs_m: float
    mean_relative: float
    missing: float
    points: int
    lag_ms: float


class _Frame(_Open):
    camera: str
    frame: int
    picture: str
    psnr: float
    boxes: dict[str, float]
    moving: _Region | None
    depth: _Depth | None


class _Evaluation(_Region):
    box_psnr_by_track: dict[str, float]
    moving: _Region | None
    depth: _Depth | None
    frames: list[_Frame]


def read_metrics(path: Path) -> dict[str, Any]:
    """The contents of metrics.json, as JSON says them.

    Raises:
        InputError: it is missing or damaged.
    """
    return _checked(path, _Metrics, METRICS_VERSION, "remove it and run again")


def read_evaluation(path: Path) -> dict[str, Any]:
    """The contents of eval.json, as JSON says them.

    Raises:
        InputError: it is missing or damaged.
    """
    return _checked(path, _Evaluation, EVALUATION_VERSION, "remove its folder and run again")


def _checked(path: Path, model: type[_Open], version: int, mend: str) -> dict[str, Any]:
    value: dict[str, Any] = storage.read_json(path)
    parse_record(path, value, model, version, mend)
    return value
