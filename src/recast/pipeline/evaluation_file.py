"""Reading eval.json back, checked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict

from recast import storage
from recast.records import parse_record
from recast.scene.evaluate_record import EVALUATION_VERSION


class _Open(BaseModel):
    """Members that nobody here reads may be anything."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)


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


def read_evaluation(path: Path) -> dict[str, Any]:
    """The contents of eval.json, as JSON says them.

    Raises:
        InputError: it is missing or damaged.
    """
    value: dict[str, Any] = storage.read_json(path)
    mend = "remove its folder and run again"
    parse_record(path, value, _Evaluation, EVALUATION_VERSION, mend)
    return value
