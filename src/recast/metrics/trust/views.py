"""How far a rollout's images are from those of the log: camera poses, held-out frames, vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from recast.arrays import Array, Int64Array
from recast.cameras import box_rectangle
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.metrics.oracle_poses import angle_to_nearest, logged_views, view_direction
from recast.simulation.rollout import Rollout

_SIDES = ("front", "left", "rear", "right")


@dataclass(frozen=True)
class GivenCamera:
    """A camera that a planner looks through, or that of the log at whose place it looks.

    Attributes:
        name: name of the log's camera.
        width: width of the images that the planner is given, pixels.
    """

    name: str
    width: int


@dataclass(frozen=True)
class HeldOutFrame:
    """Scores of a street in one image that it was not trained on; `psnr` in dB."""

    camera: str
    timestamp_us: int
    psnr: float
    ssim: float


@dataclass(frozen=True)
class VehicleView:
    """How one image shows the vehicle, by its box.

    Attributes:
        pixels: area of the rectangle around the box, as far as it is in the image; 0 if the box is
            not in the image. What lies before the vehicle is not looked at.
        side: "front", "left", "rear" or "right": the side that the camera is on.
        angle: degrees to the nearest direction from which the log shows the vehicle; None if it
            never does.
    """

    pixels: float
    side: str
    angle: float | None


class RecordedViews:
    """Poses from which a log has images, of the street and of one vehicle; made once for a log.

    Args:
        track_id: the vehicle.
    """

    def __init__(self, log: DrivingLog, track_id: str) -> None:
        self.log, self._track = log, log.tracks[track_id]
        self._poses = {
            name: log.world_from_rig.at(stream.timestamps_us) @ stream.rig_from_camera
            for name, stream in log.cameras.items()
            if len(stream.timestamps_us)
        }
        self._directions = logged_views(log, self._track)

    def offsets(self, rollout: Rollout, steps: Int64Array, cameras: Sequence[GivenCamera]) -> Array:
        """How far the ego's cameras are from the log's, (M, 2): metres, and degrees of the axes.

        Each camera is compared with the nearest pose of the same camera in the log; the mean is
        over cameras. NaN if the log has no image of any of them.

        Args:
            steps: (M,) int64 steps of the rollout.
        """
        found = []
        for camera in cameras:
            if camera.name not in self._poses:
                continue
            logged = self._poses[camera.name]
            mount = self.log.cameras[camera.name].rig_from_camera
            poses = rollout.world_from_rig[steps] @ mount
            apart = np.linalg.norm(poses[:, None, :3, 3] - logged[None, :, :3, 3], axis=-1)
            nearest = logged[np.argmin(apart, axis=1)]
            cross = np.linalg.norm(np.cross(poses[:, :3, 2], nearest[:, :3, 2]), axis=-1)
            along = np.sum(poses[:, :3, 2] * nearest[:, :3, 2], axis=-1)
            found.append(np.stack([apart.min(axis=1), np.degrees(np.arctan2(cross, along))], -1))
        return np.mean(found, axis=0) if found else np.full((len(steps), 2), np.nan)

    def quality(
        self,
        rollout: Rollout,
        steps: Int64Array,
        cameras: Sequence[GivenCamera],
        frames: Sequence[HeldOutFrame],
    ) -> tuple[float, float] | None:
        """Mean PSNR in dB and SSIM of the held-out frames nearest to the ego at each step.

        Each camera has its own frames; one without any takes those of all. None without frames.

        Args:
            steps: (M,) int64 steps of the rollout.
        """
        if not frames:
            return None
        places = self.log.world_from_rig.at([one.timestamp_us for one in frames])[:, :3, 3]
        scores = np.array([(one.psnr, one.ssim) for one in frames])
        ego = rollout.world_from_rig[steps][:, :3, 3]
        found = []
        for camera in cameras:
            own = [i for i, one in enumerate(frames) if one.camera == camera.name]
            index = np.array(own or range(len(frames)))
            apart = np.linalg.norm(ego[:, None] - places[index][None], axis=-1)
            found.append(scores[index[np.argmin(apart, axis=1)]])
        psnr, ssim = np.mean(found, axis=(0, 1))
        return float(psnr), float(ssim)

    def vehicle(self, rollout: Rollout, step: int, camera: GivenCamera) -> VehicleView:
        """How a camera at the ego's pose shows the target."""
        stream = self.log.cameras[camera.name]
        world_from_camera = rollout.world_from_rig[step] @ stream.rig_from_camera
        world_from_actor = rollout.world_from_actor[step]
        intrinsics = stream.camera.rectified()
        rectangle = box_rectangle(
            rollout.actor_size, se3.inverse(world_from_camera) @ world_from_actor, intrinsics
        )
        area = 0.0
        if rectangle is not None:
            limits = np.array([intrinsics.width, intrinsics.height], np.float64)
            sides = np.minimum(rectangle[2:], limits) - np.maximum(rectangle[:2], 0.0)
            area = float(np.prod(np.maximum(sides, 0.0))) * (camera.width / intrinsics.width) ** 2
        direction = view_direction(world_from_actor, world_from_camera)
        quarter = round(float(np.arctan2(direction[1], direction[0])) / (np.pi / 2)) % 4
        angle = angle_to_nearest(direction, self._directions) if len(self._directions) else None
        return VehicleView(area, _SIDES[quarter], angle)
