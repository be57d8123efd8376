"""What an evaluation of a scene found, in memory and as eval.json; views beside the drive."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from recast.arrays import Array, Image
from recast.core.names import folder_name
from recast.geometry import boxes, se3
from recast.logs import DrivingLog
from recast.reconstruction.scores import DepthScore, RegionScore, mean_depth, mean_score
from recast.reconstruction.views import TrainingView, scaled_camera
from recast.scene.poses import pose_at

CAMERA_CLEARANCE_M = 0.3
"""Between a shifted camera and any labelled box."""
EVALUATION_VERSION = 3
"""2 has all members of 1, and lpips, moving, depth, shifts and shift_truth; 3 a picture a frame."""


@dataclass(frozen=True)
class ViewShift:
    """A change of the ego's pose in its own frame, at the rear axle.

    Attributes:
        lateral_m: metres to the left.
        yaw_deg: degrees, counter-clockwise from above.
    """

    lateral_m: float = 0.0
    yaw_deg: float = 0.0

    @property
    def name(self) -> str:
        """Of files and rows, such as "left-2m" or "turned-right-5deg"."""
        parts = []
        if self.lateral_m:
            parts.append(f"{'left' if self.lateral_m > 0 else 'right'}-{abs(self.lateral_m):g}m")
        if self.yaw_deg:
            side = "left" if self.yaw_deg > 0 else "right"
            parts.append(f"turned-{side}-{abs(self.yaw_deg):g}deg")
        return "-".join(parts) or "logged"

    @property
    def rig_from_shifted(self) -> Array:
        """(4, 4)."""
        rotation = se3.rotation_z(np.deg2rad(self.yaw_deg))
        return se3.from_rotation_translation(rotation, np.array([0.0, self.lateral_m, 0.0]))


SHIFTS: tuple[ViewShift, ...] = (
    *(ViewShift(lateral_m=metres) for metres in (1.0, -1.0, 2.0, -2.0, 3.0, -3.0)),
    *(ViewShift(yaw_deg=degrees) for degrees in (5.0, -5.0, 10.0, -10.0)),
)
"""A lane's width to either side, and the yaw that changing lanes takes."""


def picture_name(camera_name: str, frame: int) -> str:
    """File name of a picture of one view: the camera's name as far as it can stand in one."""
    return f"{folder_name(camera_name)}_{frame:06d}.png"


@dataclass(frozen=True)
class ShiftedView(TrainingView):
    """A view that the log does not have: a logged one from the shifted ego.

    Attributes:
        shift: shift of the ego. Camera name, frame and time are those of the logged view; the pose
            `world_from_camera` (4, 4) is shifted.
    """

    shift: ViewShift = ViewShift()

    @property
    def picture(self) -> str:
        """File below the evaluation's folder."""
        return f"shifts/{self.shift.name}/{picture_name(self.camera_name, self.frame)}"


Truth = Callable[[Sequence[ShiftedView]], Iterator[Image]]
"""What the cameras of shifted views truly see: (H, W, 3) uint8 each, in their order."""


@dataclass(frozen=True)
class ShiftedScore:
    """Scores of one shifted view.

    Attributes:
        camera, frame, timestamp_us: the logged view that it was.
        moving: scores inside the boxes of moving objects, or None where too little moves.
    """

    camera: str
    frame: int
    timestamp_us: int
    whole: RegionScore
    moving: RegionScore | None


@dataclass(frozen=True)
class ShiftScores:
    """All views with one shift of the ego.

    Attributes:
        frames: scores; none where the truth is not known.
        pictures: files below the evaluation's folder.
    """

    shift: ViewShift
    frames: tuple[ShiftedScore, ...]
    pictures: tuple[str, ...]

    @property
    def whole(self) -> RegionScore | None:
        """Mean over images; None where the truth is not known."""
        return mean_score([frame.whole for frame in self.frames])

    @property
    def moving(self) -> RegionScore | None:
        """Mean over images in which something moves."""
        return mean_score([frame.moving for frame in self.frames if frame.moving is not None])


def shifted_views(
    log: DrivingLog, frames: Sequence[tuple[str, int]], scale: float, shift: ViewShift
) -> list[ShiftedView]:
    """Logged views from the shifted ego, but for those whose camera would be inside a labelled box.

    Args:
        frames: camera and frame of each.
        scale: scale of the images.
    """
    found = []
    for name, frame in frames:
        stream = log.cameras[name]
        timestamp_us = int(stream.timestamps_us[frame])
        world_from_rig = log.world_from_rig.at(timestamp_us) @ shift.rig_from_shifted
        pose = world_from_rig @ stream.rig_from_camera
        if not _inside_a_box(log, pose[:3, 3], timestamp_us):
            place = (name, frame, timestamp_us, scaled_camera(stream.camera, scale), pose)
            found.append(ShiftedView(*place, held_out=True, shift=shift))
    return found


def _inside_a_box(log: DrivingLog, point: Array, timestamp_us: int) -> bool:
    for track in log.tracks.values():
        pose = pose_at(track.trajectory, timestamp_us)
        if pose is None:
            continue
        if boxes.contains(point[None], track.size, pose, CAMERA_CLEARANCE_M)[0]:
            return True
    return False


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
