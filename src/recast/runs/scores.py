"""metrics.json, everything that a run measured, and eval.json: written, and read back checked.

A `ScoredRollout` is a stored rollout with its scores; `RunTrust` says how far to trust it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, field_validator

from recast.actors import load_actor
from recast.core import Artefact, files
from recast.core.records import parse_record
from recast.logs import DrivingLog, HdMap
from recast.metrics import (
    COLUMNS,
    BaseMetric,
    RolloutMetrics,
    columns_of,
    matched_pairs,
    own_metrics,
    rollout_metrics,
    table,
)
from recast.metrics.trust import (
    SIGHTLESS,
    GivenCamera,
    HeldOutFrame,
    RecordedViews,
    RolloutTrust,
    TrustCalibration,
    TrustFeatures,
    judge,
    packaged_calibration,
    trust_features,
)
from recast.planning import ShownView
from recast.reconstruction.evaluate import EVALUATION_VERSION
from recast.reconstruction.scores import DepthScore, RegionScore
from recast.runs.arms import Arm, under_other_noise
from recast.runs.config import RunConfig
from recast.runs.rollouts import given_views, read_coverage, read_gaps, read_rollout
from recast.runs.run_folder import ACTOR_FOLDER, VIEWS_FOLDER, rollout_name, use_name, use_parts
from recast.scene.street_scene import ViewGaps
from recast.simulation import Rollout, RolloutFailure
from recast.simulation.oracle_renderer import OracleRenderer
from recast.simulation.scene_renderer import RolloutCoverage, RolloutGaps


@dataclass(frozen=True)
class ScoredRollout:
    """A stored rollout of an arm, scored, with what else its trust depends on.

    Attributes:
        folder: folder that `make_rollout` wrote.
        coverage: coverage of its vehicle; None for a vehicle without shares.
        gaps: what its images showed that the log does not; None if that is not known.
        evaluation: held-out scores of its street; None if no image was held out.
        disturbed: the same scenario, planner and arm under other noise.
    """

    arm: Arm
    folder: Path
    metrics: RolloutMetrics
    coverage: RolloutCoverage | None
    gaps: RolloutGaps | None
    evaluation: Artefact | None
    disturbed: tuple[RolloutMetrics, ...]


def scored_rollouts(
    motion: str,
    planner: str,
    arms: Sequence[Arm],
    find: Callable[[str], Artefact | None],
    hd_map: HdMap,
    own: Sequence[BaseMetric] = (),
) -> dict[str, ScoredRollout | RolloutFailure]:
    """The rollouts of a scenario that were made, by arm.

    Args:
        motion, planner: names of the motion and the planner in the run's config.
        find: function that gives the artefact of a use; None if the run has none.
        hd_map: lanes and drivable area that they are judged by.
        own: own metrics.

    Raises:
        InputError: a record is missing or damaged, or an own metric fails.
    """
    made = {arm.name: find(rollout_name(motion, planner, arm.name)) for arm in arms}
    folders = {name: artefact.path for name, artefact in made.items() if artefact is not None}
    results = {name: read_rollout(folder) for name, folder in folders.items()}
    metrics = {
        name: rollout_metrics(result, hd_map, own)
        for name, result in results.items()
        if isinstance(result, Rollout)
    }
    found: dict[str, ScoredRollout | RolloutFailure] = {}
    for arm in arms:
        result = results.get(arm.name)
        if isinstance(result, RolloutFailure):
            found[arm.name] = result
        elif result is not None:
            disturbed = (one.name for one in under_other_noise(arm, arms))
            found[arm.name] = ScoredRollout(
                arm,
                folders[arm.name],
                metrics[arm.name],
                read_coverage(folders[arm.name]),
                read_gaps(folders[arm.name]),
                find(use_name("evaluation", arm.street)),
                tuple(metrics[name] for name in disturbed if name in metrics),
            )
    return found


METRICS_VERSION: Literal[5] = 5


def write_metrics(
    path: Path, config: RunConfig, used: Mapping[str, Artefact], hd_map: HdMap, trust: RunTrust
) -> None:
    """Score all rollouts of a run and write them with what its other artefacts measured.

    Each rollout's entry has, besides `RolloutMetrics.to_json`, a member `shorter`: by number of
    steps, its scores over the first steps alone, for each length at which the rollout of another
    arm was cut in the same scenario. `coverage`: what its cameras showed of an actor with shares,
    see `RolloutCoverage.to_json`, or None. `gaps`: what the planner's images showed that the log
    does not, see `RolloutGaps`, or None. And `trust`: how far to trust its verdict, see
    `RolloutTrust.to_json`; None for the truth.

    Args:
        used: the artefacts of the run by use, as far as they were made.
        hd_map: lanes and drivable area that the rollouts are judged by.
        trust: `RunTrust` of the rollouts' log.
    """
    rollouts: list[ScoredRollout] = []
    failures: list[RolloutFailure] = []
    own = own_metrics(config.metrics)
    for motion, planner in product(config.motions, config.planners):
        found = scored_rollouts(motion, planner, config.arms, used.get, hd_map, own)
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
                    "gaps": None if one.gaps is None else asdict(one.gaps),
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
    return {str(n): {key: one.value for key, one in values.items()} for n, values in parts.items()}


def _differences(
    metrics: Sequence[RolloutMetrics],
    failures: Sequence[RolloutFailure],
    candidate: str,
    baseline: str,
) -> list[dict[str, Any]]:
    """A line for each metric that a pair has: the mean in the column's unit, and over what."""
    pairs = matched_pairs({"": metrics}, candidate, baseline, {"": failures})
    found = []
    for name, column in columns_of(metrics).items():
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
    gaps: ViewGaps | None
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


class RunTrust:
    """Judges the rollouts of one log and target.

    Args:
        track: id of the target's track.
        calibration: calibration to judge by; that of the package if None.
    """

    def __init__(
        self, log: DrivingLog, track: str, calibration: TrustCalibration | None = None
    ) -> None:
        self._log, self._track, self._calibration = log, track, calibration

    @cached_property
    def _recorded(self) -> RecordedViews:
        return RecordedViews(self._log, self._track)

    def of(self, rollout: ScoredRollout) -> RolloutTrust | None:
        """The trust of a rollout; None for one that shows the truth.

        Raises:
            InputError: a record is missing or damaged.
        """
        if rollout.arm.is_truth:
            return None
        features = self.features(rollout)
        return SIGHTLESS if features is None else self._judged(features)

    def features(self, rollout: ScoredRollout) -> TrustFeatures | None:
        """The features of a rollout, see `of`; None if its planner looks at no images."""
        cameras = self._cameras(given_views(rollout.folder))
        if not cameras:
            return None
        scores = rollout.evaluation
        return trust_features(
            rollout.metrics,
            self._recorded,
            cameras,
            rollout.coverage,
            () if scores is None else held_out_frames(scores.path / "eval.json"),
            rollout.disturbed,
        )

    def of_process(self, metrics: RolloutMetrics) -> RolloutTrust | None:
        """The trust of a rollout that was run in this process, without shares and held-out scores.

        None for one that was read from disk or shows the truth.
        """
        origin = metrics.rollout.origin
        if origin is None or isinstance(origin.renderer, OracleRenderer):
            return None
        if origin.renderer is None:
            return SIGHTLESS
        mounts = {n: m for n, m in origin.renderer.mounts.items() if n in self._log.cameras}
        cameras = tuple(GivenCamera(name, mount.camera.width) for name, mount in mounts.items())
        if not cameras:
            return None
        return self._judged(trust_features(metrics, self._recorded, cameras, None, ()))

    def _judged(self, features: TrustFeatures) -> RolloutTrust:
        return judge(features, self._calibration or packaged_calibration())

    def _cameras(self, views: tuple[ShownView, ...]) -> tuple[GivenCamera, ...]:
        """The log's cameras at whose places a planner looks; all for a view with its own place."""
        widths: dict[str, int] = {}
        for view in views:
            known = view.source is not None and view.source in self._log.cameras
            for name in (str(view.source),) if known else self._log.cameras:
                widths[name] = max(view.width, widths.get(name, 0))
        return tuple(GivenCamera(name, width) for name, width in widths.items())


def held_out_frames(path: Path) -> tuple[HeldOutFrame, ...]:
    """The frames of an eval.json.

    Raises:
        InputError: it is missing or damaged.
    """
    keys = ("camera", "timestamp_us", "psnr", "ssim")
    frames = read_evaluation(path)["frames"]
    return tuple(HeldOutFrame(*(one[key] for key in keys)) for one in frames)


def trust_of_process(rollout: Rollout, metrics: RolloutMetrics) -> RolloutTrust | None:
    """See `RunTrust.of_process`."""
    if rollout.origin is None:
        return None
    return RunTrust(rollout.origin.setup.log, rollout.track_id).of_process(metrics)
