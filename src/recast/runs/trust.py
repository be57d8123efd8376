"""How far to trust the rollouts of a log: gathers what `recast.metrics.trust` reads of them."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

from recast.logs import DrivingLog
from recast.metrics import RolloutMetrics
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
from recast.runs.rollouts import given_views
from recast.runs.scored_rollouts import ScoredRollout
from recast.runs.scores import read_evaluation
from recast.simulation import Rollout
from recast.simulation.oracle_renderer import OracleRenderer


class RunTrust:
    """Judges the rollouts of one log and target.

    Args:
        log: log that the rollouts were run on.
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
