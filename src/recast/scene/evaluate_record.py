"""What an evaluation of a scene found, in memory and as eval.json; how far its depths are off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from typing import Any

import numpy as np

from recast.logs import DrivingLog, LidarStream, Track
from recast.scene.evaluate_shifts import ShiftedScore, ShiftScores, picture_name
from recast.scene.points import OwnedSweep, depth_samples, read_sweeps
from recast.scene.render import SceneImage
from recast.scene.scores import RegionScore, mean_score
from recast.scene.views import TrainingView

SWEEP_REACH_US = 120_000
"""Sweeps further from an image in time are not its own: KITTI's may miss every other frame."""
SURFACE_ALPHA = 0.5
"""Where the scene covers less of a pixel, it has no surface there."""
EVALUATION_VERSION = 3
"""2 has all members of 1, and lpips, moving, depth, shifts and shift_truth; 3 a picture a frame."""


@dataclass(frozen=True)
class FrameScore:
    """Scores of one held-out image.

    Attributes:
        whole: scores over all usable pixels.
        boxes: PSNR in dB inside the rectangle around each visible actor's projected box.
        moving: scores inside the boxes of all that moves, length and width times 1.5; None where
            too little moves.
        depth: depth scores against the LiDAR; None where the log has no sweep then.
    """

    camera: str
    frame: int
    timestamp_us: int
    whole: RegionScore
    boxes: Mapping[str, float]
    moving: RegionScore | None
    depth: DepthScore | None


@dataclass(frozen=True)
class SceneEvaluation:
    """Scores of all held-out images; means are over images, and over (image, actor) for boxes.

    Attributes:
        frames: held-out images.
        shifts: views beside the drive; none where they were not asked for.
        shift_truth: whether the shifted views were compared with the truth.
    """

    frames: tuple[FrameScore, ...]
    shifts: tuple[ShiftScores, ...] = ()
    shift_truth: bool = False

    @property
    def whole(self) -> RegionScore:
        """Mean over the images."""
        found = mean_score([frame.whole for frame in self.frames])
        if found is None:
            raise ValueError("SceneEvaluation: no image was scored")
        return found

    @property
    def psnr(self) -> float:
        """Mean PSNR in dB."""
        return self.whole.psnr

    @property
    def ssim(self) -> float:
        """Mean SSIM."""
        return self.whole.ssim

    @property
    def lpips(self) -> float | None:
        """Mean LPIPS; None where no weights were given."""
        return self.whole.lpips

    @property
    def box_psnr(self) -> float | None:
        """Mean PSNR in dB inside the actors' boxes; None where no actor is seen."""
        values = [value for frame in self.frames for value in frame.boxes.values()]
        return float(np.mean(values)) if values else None

    def box_psnr_by_track(self) -> dict[str, float]:
        """Mean PSNR in dB inside each actor's box."""
        tracks = sorted({track for frame in self.frames for track in frame.boxes})
        return {
            track: float(np.mean([f.boxes[track] for f in self.frames if track in f.boxes]))
            for track in tracks
        }

    @property
    def moving(self) -> RegionScore | None:
        """Mean over the images in which something moves: PSNR*, SSIM* and LPIPS*."""
        return mean_score([frame.moving for frame in self.frames if frame.moving is not None])

    @property
    def depth(self) -> DepthScore | None:
        """Mean over the images with LiDAR."""
        return mean_depth([frame.depth for frame in self.frames if frame.depth is not None])

    def to_json(self) -> dict[str, Any]:
        """The contents of eval.json; a frame's `picture` is its file, if pictures are written."""
        return {
            "version": EVALUATION_VERSION,
            "psnr": self.psnr,
            "ssim": self.ssim,
            "lpips": self.lpips,
            "box_psnr": self.box_psnr,
            "box_psnr_by_track": self.box_psnr_by_track(),
            "moving": _plain(self.moving),
            "depth": _plain(self.depth),
            "frames": [
                _frame(frame, picture=picture_name(frame.camera, frame.frame))
                for frame in self.frames
            ],
            "shift_truth": self.shift_truth,
            "shifts": [_shift(scores) for scores in self.shifts],
        }


def _shift(scores: ShiftScores) -> dict[str, Any]:
    return {
        "name": scores.shift.name,
        **asdict(scores.shift),
        "whole": _plain(scores.whole),
        "moving": _plain(scores.moving),
        "frames": [_frame(frame) for frame in scores.frames],
        "pictures": list(scores.pictures),
    }


def _frame(frame: FrameScore | ShiftedScore, **more: str) -> dict[str, Any]:
    values = asdict(frame)
    image = {name: values.pop(name) for name in ("camera", "frame", "timestamp_us")}
    return {**image, **more, **values.pop("whole"), **values}


def _plain(score: RegionScore | DepthScore | None) -> dict[str, Any] | None:
    return None if score is None else asdict(score)


@dataclass(frozen=True)
class DepthScore:
    """Depth along the camera's axis against LiDAR points, metres.

    Attributes:
        points: LiDAR points compared.
        missing: share of the points in whose pixel the scene is open sky; not in the errors.
        median_abs_m, mean_abs_m: median and mean of |rendered - measured|, metres.
        mean_relative: mean of |rendered - measured| / measured.
        lag_ms: mean time between image and sweep, milliseconds. Training kept its hands off sweeps
            within 20 ms of a held-out image; others it has seen.
    """

    points: int
    missing: float
    median_abs_m: float
    mean_abs_m: float
    mean_relative: float
    lag_ms: float


class SweepsOfImages:
    """The sweep of each LiDAR that is nearest in time to an image.

    A sweep is read once for all cameras of its moment, as long as they are asked for in order of
    time: the last one of each LiDAR is kept.

    Args:
        actors: tracks whose points are told from the street's.
    """

    def __init__(self, log: DrivingLog, actors: Mapping[str, Track]) -> None:
        self._log, self._actors = log, actors
        self._kept: dict[str, tuple[int, list[OwnedSweep]]] = {}

    def at(self, timestamp_us: int) -> list[OwnedSweep]:
        """Those within `SWEEP_REACH_US` of an image, one of each LiDAR at most, by time."""
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
    rendered: SceneImage,
    view: TrainingView,
    sweeps: Sequence[OwnedSweep],
    actors: Mapping[str, Track],
) -> DepthScore | None:
    """Score the expected depth, sum of T alpha z / alpha, in the pixels of LiDAR points.

    Points of moving objects are carried with their box to the view's time; points hidden from the
    camera are left out. From 1 m to 100 m.

    Args:
        rendered: image drawn from the view's pose.
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
    points, *columns = zip(*(astuple(score) for score in scores), strict=True)
    return DepthScore(sum(points), *(float(np.mean(column)) for column in columns))
