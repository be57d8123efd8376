"""What an evaluation of a scene found, in memory and as eval.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from recast.scene.evaluate_depth import DepthScore, mean_depth
from recast.scene.evaluate_regions import RegionScore, mean_score
from recast.scene.evaluate_shifts import ShiftScores, picture_name

EVALUATION_VERSION = 3
"""2 has all members of 1, and lpips, moving, depth, shifts and shift_truth; 3 a picture a frame."""


@dataclass(frozen=True)
class FrameScore:
    """Scores of one held-out image.

    Attributes:
        camera, frame, timestamp_us: which image.
        whole: of all usable pixels.
        boxes: PSNR in dB inside the rectangle around each visible actor's projected box.
        moving: inside the boxes of all that moves, length and width times 1.5; None where too
            little does.
        depth: against the LiDAR; None where the log has no sweep then.
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
                {
                    "camera": frame.camera,
                    "frame": frame.frame,
                    "timestamp_us": frame.timestamp_us,
                    "picture": picture_name(frame.camera, frame.frame),
                    **asdict(frame.whole),
                    "boxes": dict(frame.boxes),
                    "moving": _plain(frame.moving),
                    "depth": _plain(frame.depth),
                }
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
        "frames": [
            {
                "camera": frame.camera,
                "frame": frame.frame,
                "timestamp_us": frame.timestamp_us,
                **asdict(frame.whole),
                "moving": _plain(frame.moving),
            }
            for frame in scores.frames
        ],
        "pictures": list(scores.pictures),
    }


def _plain(score: RegionScore | DepthScore | None) -> dict[str, Any] | None:
    return None if score is None else asdict(score)
