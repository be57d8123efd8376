"""Features of a rollout that need no truth and tell how far to trust its verdict.

`RecordedViews` says how far a rollout's images are from those of the log: camera poses, held-out
frames, vehicle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from recast.actors.actor import Coverage
from recast.arrays import Array, Int64Array
from recast.cameras import box_rectangle
from recast.dynamics import plan_to_poses
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.metrics.driving import CAP
from recast.metrics.oracle_views import angle_to_nearest, logged_views, view_direction
from recast.metrics.rollout_metrics import RolloutMetrics, least_gaps
from recast.simulation.rollout import Rollout
from recast.simulation.scene_renderer import RolloutCoverage

_SIDES = ("front", "left", "rear", "right")


@dataclass(frozen=True)
class GivenCamera:
    """A camera that a planner looks through, or that of the log at whose place it looks.

    Attributes:
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


@dataclass(frozen=True)
class Feature:
    """A feature of a rollout.

    Attributes:
        what: its meaning, for people.
        sign: 1 if more of it can only raise the trust, -1 if it can only lower it, 0 if either may
            be; None for one that the model does not read.
        logarithmic: whether the model reads log(1 + value): lengths and sizes, whose small values
            matter most.
    """

    what: str
    sign: Literal[-1, 0, 1] | None
    logarithmic: bool = False


FEATURES: Mapping[str, Feature] = {
    "seen": Feature("share of the shown target that the log has images of", 1),
    "mirrored": Feature("share of the shown target mirrored from its other side", None),
    "invented": Feature("share of the shown target that the generator invented", -1),
    "without_shares": Feature("1 if it is unknown which parts of the target were seen", 0),
    "view_angle_deg": Feature("degrees from the log's views of the target", -1),
    "camera_distance_m": Feature("metres from the log's nearest camera pose", -1, True),
    "camera_angle_deg": Feature("degrees from the log's nearest camera pose", -1, True),
    "held_out_psnr_db": Feature("PSNR in dB of the nearest held-out frames", 1),
    "held_out_ssim": Feature("SSIM of the nearest held-out frames", 1),
    "vehicle_px": Feature("size in pixels of the target at the plan that changed most", 0, True),
    "plan_change_m": Feature("largest change between plans in metres", -1, True),
    "gap_m": Feature("smallest gap in metres, of a rollout without a collision", 1, True),
    "contact_speed_mps": Feature("relative speed in m/s at the contact, of a collision", 1),
    "least_ttc_s": Feature(
        "least time to collision in seconds, of a rollout without a collision", 1
    ),
    "noise_flips": Feature("share of the arm's rollouts with other noise that end differently", -1),
    "collision": Feature("1 if the verdict is a collision", 0),
}
"""All features by name. Shares and angles of the vehicle are means over the images of the plans
that led to the verdict, weighed by the vehicle's area. `mirrored` is what `seen` and `invented`
leave, so that the model's signs order the three."""
SHARES = ("seen", "mirrored", "invented")


@dataclass(frozen=True)
class TrustFeatures:
    """The features of one rollout, and the steps that its verdict rests on.

    Attributes:
        values: values of the features, by name; a feature that is not known is not there.
        missing: reasons why features are not known, by name, in words.
        changed: plan step at which the plan changed most, the plan that mattered.
        closest: step of the first contact, or of the smallest gap without one.
        view: how the camera that shows it largest shows the vehicle at `changed`; None if no
            camera shows it.
        coverage: coverage of the planner's images at `changed`; None if the vehicle has no shares.
    """

    values: Mapping[str, float]
    missing: Mapping[str, str]
    changed: int
    closest: int
    view: VehicleView | None
    coverage: Coverage | None


def trust_features(
    metrics: RolloutMetrics,
    recorded: RecordedViews,
    cameras: Sequence[GivenCamera],
    coverage: RolloutCoverage | None,
    frames: Sequence[HeldOutFrame],
    disturbed: Sequence[RolloutMetrics] = (),
) -> TrustFeatures:
    """The features of a scored rollout of a planner that looks at images.

    Only plans before the first contact count: what comes later has no part in the verdict.

    Args:
        cameras: cameras that the planner is given; at least one.
        coverage: coverage of the rollout's images; None for a vehicle without shares.
        frames: held-out scores of the street; empty if no image was held out.
        disturbed: the same scenario, planner and arm under other noise; empty if it was not driven
            so.

    Raises:
        ValueError: no plan, or no camera.
    """
    rollout, contact = metrics.rollout, metrics.collision.first_step
    if not len(rollout.plan_steps) or not cameras:
        raise ValueError(
            f"trust_features: {metrics.plans} plans, {len(cameras)} cameras, expected 1 or more"
        )
    count = len(rollout.plan_steps)
    if contact is not None:
        count = max(1, int(np.searchsorted(rollout.plan_steps, contact)))
    steps = rollout.plan_steps[:count]
    values: dict[str, float] = {"collision": float(contact is not None)}
    missing: dict[str, str] = {}
    changes = plan_changes(rollout)[: count - 1]
    # Rounded, or noise of 1e-15 would decide between plans that hardly change.
    changed = int(steps[1 + int(np.argmax(changes.round(6)))] if len(changes) else steps[0])
    if len(changes):
        values["plan_change_m"] = float(changes.max())
    else:
        missing["plan_change_m"] = "only one plan led to the verdict"
    gaps, speed = least_gaps(rollout), metrics.contact_speed
    closest = int(np.argmin(gaps)) if contact is None else contact
    if speed is None:
        values["gap_m"] = float(gaps[closest])
        missing["contact_speed_mps"] = "the rollout has no contact"
    else:
        values["contact_speed_mps"] = speed
        missing["gap_m"] = "the rollout collides"
    least = None if metrics.ttc.ttc.value is None else float(metrics.ttc.per_cycle.min())
    if contact is None and least is not None:
        values["least_ttc_s"] = min(least, CAP)
    else:
        reason = "the time to collision has no value" if contact is None else "the rollout collides"
        missing["least_ttc_s"] = reason
    if disturbed:
        values["noise_flips"] = float(np.mean([not metrics.same_verdict(one) for one in disturbed]))
    else:
        missing["noise_flips"] = "the arm was not driven with other noise"
    _add_shares(values, missing, coverage, steps)
    view = _add_views(values, missing, rollout, recorded, cameras, steps, changed)
    _add_street(values, missing, rollout, recorded, cameras, steps, frames)
    at = None if coverage is None else _of_steps(coverage, np.array([changed]))
    return TrustFeatures(values, missing, changed, closest, view, at)


def plan_changes(rollout: Rollout) -> Array:
    """(C-1,) mean metres between each plan and the one before it, at the times of both.

    Zero for two plans without a common time.
    """
    starts, found = rollout.ego[rollout.plan_steps, :3], []
    poses = plan_to_poses(starts, rollout.predictions)[..., 1:, :2]
    for i, between in enumerate(np.diff(rollout.plan_steps)):
        common = poses.shape[1] - int(between)
        before, after = poses[i, int(between) :], poses[i + 1, : max(common, 0)]
        apart = np.linalg.norm(before - after, axis=-1)
        found.append(float(apart.mean()) if common > 0 else 0.0)
    return np.array(found)


def _of_steps(coverage: RolloutCoverage, steps: Int64Array) -> Coverage:
    """Shares of the vehicle in the planner's images at some steps; all images if it has none."""
    images = (coverage.of_planner or coverage).images
    return Coverage.mean(one.coverage for one in images if one.step in steps)


def _add_shares(
    values: dict[str, float],
    missing: dict[str, str],
    coverage: RolloutCoverage | None,
    steps: Int64Array,
) -> None:
    values["without_shares"] = float(coverage is None)
    mean = None if coverage is None else _of_steps(coverage, steps)
    if mean is not None and mean.pixels > 0:
        values.update({name: getattr(mean, name) for name in SHARES})
        return
    reason = (
        "the target's shares were not measured" if mean is None else "no image shows the target"
    )
    missing.update(dict.fromkeys(SHARES, reason))


def _add_views(
    values: dict[str, float],
    missing: dict[str, str],
    rollout: Rollout,
    recorded: RecordedViews,
    cameras: Sequence[GivenCamera],
    steps: Int64Array,
    changed: int,
) -> VehicleView | None:
    views = {
        int(step): [recorded.vehicle(rollout, int(step), camera) for camera in cameras]
        for step in steps
    }
    shown = [one for several in views.values() for one in several if one.pixels > 0]
    if not shown:
        missing["view_angle_deg"] = "no image shows the target"
    elif any(one.angle is None for one in shown):
        missing["view_angle_deg"] = "the log never shows the target well"
    else:
        weights = [one.pixels for one in shown]
        angles = [one.angle for one in shown if one.angle is not None]
        values["view_angle_deg"] = float(np.average(angles, weights=weights))
    largest = max(views[changed], key=lambda one: one.pixels)
    values["vehicle_px"] = float(np.sqrt(largest.pixels))
    return largest if largest.pixels > 0 else None


def _add_street(
    values: dict[str, float],
    missing: dict[str, str],
    rollout: Rollout,
    recorded: RecordedViews,
    cameras: Sequence[GivenCamera],
    steps: Int64Array,
    frames: Sequence[HeldOutFrame],
) -> None:
    offsets = recorded.offsets(rollout, steps, cameras).mean(axis=0)
    for name, offset in zip(("camera_distance_m", "camera_angle_deg"), offsets, strict=True):
        if np.isfinite(offset):
            values[name] = float(offset)
        else:
            missing[name] = "the log has no image of these cameras"
    quality = recorded.quality(rollout, steps, cameras, frames)
    for i, name in enumerate(("held_out_psnr_db", "held_out_ssim")):
        if quality is None:
            missing[name] = "the street has no held-out scores"
        else:
            values[name] = quality[i]
