"""Views beside the recorded drive: the ego's pose moved sideways or turned."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from recast.arrays import Array, Image
from recast.core.names import folder_name
from recast.geometry import boxes, se3
from recast.logs import DrivingLog
from recast.scene.dynamic import pose_at
from recast.scene.scores import RegionScore, mean_score
from recast.scene.views import TrainingView, scaled_camera

CAMERA_CLEARANCE_M = 0.3
"""Between a shifted camera and any labelled box."""


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
