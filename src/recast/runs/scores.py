"""metrics.json, everything that a run measured, and eval.json: written, and read back checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import BaseModel, ConfigDict, field_validator

from recast.actors import load_actor
from recast.core import Artefact, files
from recast.core.records import parse_record
from recast.logs import HdMap
from recast.metrics import COLUMNS, RolloutMetrics, matched_pairs, table
from recast.reconstruction import RegionScore
from recast.reconstruction.evaluation import EVALUATION_VERSION
from recast.reconstruction.scores import DepthScore
from recast.runs.config import RunConfig
from recast.runs.layout import ACTOR_FOLDER, VIEWS_FOLDER, use_parts
from recast.runs.scored_rollouts import ScoredRollout, scored_rollouts
from recast.simulation import RolloutFailure

if TYPE_CHECKING:
    from recast.runs.trust import RunTrust

METRICS_VERSION: Literal[3] = 3


def write_metrics(
    path: Path,
    config: RunConfig,
    used: Mapping[str, Artefact],
    hd_map: HdMap,
    trust: RunTrust,
) -> None:
    """Score all rollouts of a run and write them with what its other artefacts measured.

    Each rollout's entry has, besides `RolloutMetrics.to_json`, a member `shorter`: by number of
    steps, its scores over the first steps alone, for each length at which the rollout of another
    arm was cut in the same scenario. `coverage`: what its cameras showed of an actor with shares,
    see `RolloutCoverage.to_json`, or None. And `trust`: how far to trust its verdict, see
    `RolloutTrust.to_json`; None for the truth.

    Args:
        used: the artefacts of the run by use, as far as they were made.
        hd_map: lanes and drivable area that the rollouts are judged by.
        trust: `RunTrust` of the rollouts' log.
    """
    rollouts: list[ScoredRollout] = []
    failures: list[RolloutFailure] = []
    for motion, planner in product(config.motions, config.planners):
        found = scored_rollouts(motion, planner, config.arms, used.get, hd_map)
        rollouts += [one for one in found.values() if isinstance(one, ScoredRollout)]
        failures += [one for one in found.values() if isinstance(one, RolloutFailure)]
    metrics = [one.metrics for one in rollouts]
    trusts = [trust.of(one) for one in rollouts]
    files.write_json(
        path,
        {
            "version": METRICS_VERSION,
            "table": [row.to_json() for row in table(metrics, failures)],
            "differences": [
                one
                for arm in config.arms[1:]
                for one in _differences(metrics, failures, arm.name, config.arms[0].name)
            ],
            "rollouts": [
                {
                    **one.metrics.to_json(),
                    "shorter": _shorter(one.metrics, metrics),
                    "coverage": None if one.coverage is None else one.coverage.to_json(),
                    "trust": None if trusted is None else trusted.to_json(),
                }
                for one, trusted in zip(rollouts, trusts, strict=True)
            ],
            "failures": [vars(f) for f in failures],
            "scenes": {
                name: files.read_json(artefact.path / "eval.json")
                for name, artefact in _of(used, "evaluation").items()
            },
            "truth": {
                name: files.read_json(artefact.path / VIEWS_FOLDER / "oracle_views.json")
                for name, artefact in _of(used, "truth").items()
            },
            "actors": {
                name: load_actor(artefact.path / ACTOR_FOLDER).provenance.model_dump(mode="json")
                for name, artefact in _of(used, "actor").items()
            },
        },
    )


def _of(used: Mapping[str, Artefact], what: str) -> dict[str, Artefact]:
    """The artefacts of a kind of use, by the names that follow it."""
    found = {use_parts(use): one for use, one in used.items()}
    return {"/".join(parts[1:]): one for parts, one in found.items() if parts[0] == what}


def _shorter(one: RolloutMetrics, others: Sequence[RolloutMetrics]) -> dict[str, Any]:
    lengths = {
        other.steps_run
        for other in others
        if (other.motion, other.setting, other.planner) == (one.motion, one.setting, one.planner)
        and other.steps_run < one.steps_run
    }
    parts = {steps: one.over(steps).values for steps in sorted(lengths)}
    return {str(n): {key: values[key].value for key in COLUMNS} for n, values in parts.items()}


def _differences(
    metrics: Sequence[RolloutMetrics],
    failures: Sequence[RolloutFailure],
    candidate: str,
    baseline: str,
) -> list[dict[str, Any]]:
    """A line for each metric that a pair has: the mean in the column's unit, and over what."""
    pairs = matched_pairs({"": metrics}, candidate, baseline, {"": failures})
    found = []
    for name, column in COLUMNS.items():
        one = pairs.of(name)
        if one.pairs == 0:
            continue
        mean = column.scale * float(one.differences[""].mean())
        found.append(
            {
                "candidate": candidate,
                "baseline": baseline,
                "metric": name,
                "mean": mean,
                **{key: getattr(one, key) for key in ("pairs", "asked", "plans", "cut")},
            }
        )
    return found


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


class _Trust(_Open):
    value: float
    words: str


class _Scored(_Open):
    motion: str
    setting: str
    arm: str
    planner: str
    coverage: _Coverage | None = None
    trust: _Trust | None


class _Metrics(_Open):
    table: list[_Row]
    rollouts: list[_Scored]
    failures: list[RolloutFailure]


class _Frame(_Open):
    camera: str
    frame: int
    timestamp_us: int
    picture: str
    psnr: float
    ssim: float
    boxes: dict[str, float]
    moving: RegionScore | None
    depth: DepthScore | None


class _Evaluation(_Open):
    psnr: float
    ssim: float
    box_psnr_by_track: dict[str, float]
    moving: RegionScore | None
    depth: DepthScore | None
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
    value: dict[str, Any] = files.read_json(path)
    parse_record(path, value, model, version, mend)
    return value
