"""How far the scene's surfaces are from what the laser measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from recast.logs import DrivingLog, LidarStream, Track
from recast.scene.lidar import OwnedSweep, depth_samples, read_sweeps
from recast.scene.render import SceneImage
from recast.scene.views import View

SWEEP_REACH_US = 120_000
"""Sweeps further from an image in time are not its own: KITTI's may miss every other frame."""
SURFACE_ALPHA = 0.5
"""Where the scene covers less of a pixel, it has no surface there."""


@dataclass(frozen=True)
class DepthScore:
    """Depth along the camera's axis against LiDAR points, metres.

    Attributes:
        points: LiDAR points compared.
        missing: share of the points in whose pixel the scene is open sky; not in the errors.
        median_abs_m, mean_abs_m: of |rendered - measured|.
        mean_relative: of |rendered - measured| / measured.
        lag_ms: between image and sweep. Training kept its hands off sweeps within 20 ms of a
            held-out image; others it has seen.
    """

    points: int
    missing: float
    median_abs_m: float
    mean_abs_m: float
    mean_relative: float
    lag_ms: float


class NearestSweeps:
    """The sweep of each LiDAR that is nearest in time to an image.

    A sweep is read once for all cameras of its moment, as long as they are asked for in order of
    time: the last one of each LiDAR is kept.

    Args:
        log: with the sweeps.
        actors: tracks whose points are told from the street's.
    """

    def __init__(self, log: DrivingLog, actors: Mapping[str, Track]) -> None:
        self._log, self._actors = log, actors
        self._kept: dict[str, tuple[int, list[OwnedSweep]]] = {}

    def at(self, timestamp_us: int) -> list[OwnedSweep]:
        """Those within `SWEEP_REACH_US` of an image, at most one of each LiDAR, in order of time.

        Args:
            timestamp_us: of the image.
        """
        found: list[OwnedSweep] = []
        for stream in self._log.lidars.values():
            if len(stream.timestamps_us) == 0:
                continue
            index = int(np.argmin(np.abs(stream.timestamps_us - timestamp_us)))
            if abs(int(stream.timestamps_us[index]) - timestamp_us) <= SWEEP_REACH_US:
                found += self._read(stream, index)
        return sorted(found, key=lambda sweep: sweep.timestamp_us)

    def _read(self, stream: LidarStream, index: int) -> list[OwnedSweep]:
        kept = self._kept.get(stream.name)
        if kept is None or kept[0] != index:
            own = replace(
                stream,
                timestamps_us=stream.timestamps_us[[index]],
                sweeps=[stream.sweeps[index]],
            )
            log = replace(self._log, lidars={stream.name: own})
            kept = (index, read_sweeps(log, self._actors, held_out_us=()))
            self._kept[stream.name] = kept
        return kept[1]


def depth_score(
    rendered: SceneImage, view: View, sweeps: Sequence[OwnedSweep], actors: Mapping[str, Track]
) -> DepthScore | None:
    """Score the expected depth, sum of T alpha z / alpha, in the pixels of LiDAR points.

    Points of moving objects are carried with their box to the view's time; points hidden from the
    camera are left out. From 1 m to 100 m.

    Args:
        rendered: drawn from the view's pose.
        sweeps: see `NearestSweeps`.
        actors: the tracks that the sweeps were divided by.

    Returns:
        None where no point is seen, or the scene has a surface at none of them.
    """
    samples = depth_samples(view, sweeps, actors, window_us=SWEEP_REACH_US)
    columns, rows = np.floor(samples.uv).astype(np.int64).T
    alpha = rendered.alpha[rows, columns]
    lags = [abs(sweep.timestamp_us - view.timestamp_us) for sweep in sweeps]
    covered = alpha >= SURFACE_ALPHA
    if not covered.any():
        return None
    measured = samples.depths[covered].astype(np.float64)
    error = np.abs(rendered.depth[rows, columns][covered] / alpha[covered] - measured)
    return DepthScore(
        points=len(samples.depths),
        missing=float(np.mean(~covered)),
        median_abs_m=float(np.median(error)),
        mean_abs_m=float(np.mean(error)),
        mean_relative=float(np.mean(error / measured)),
        lag_ms=float(np.mean(lags)) / 1000,
    )


def mean_depth(scores: Sequence[DepthScore]) -> DepthScore | None:
    """Means over images, and all their points; None of nothing."""
    if not scores:
        return None
    return DepthScore(
        points=sum(score.points for score in scores),
        missing=float(np.mean([score.missing for score in scores])),
        median_abs_m=float(np.mean([score.median_abs_m for score in scores])),
        mean_abs_m=float(np.mean([score.mean_abs_m for score in scores])),
        mean_relative=float(np.mean([score.mean_relative for score in scores])),
        lag_ms=float(np.mean([score.lag_ms for score in scores])),
    )
