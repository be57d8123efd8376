"""What is measured in a recorded drive, to tell whether a vehicle can have recorded it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from recast.arrays import Array
from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.logs import motion
from recast.logs.types import (
    VEHICLES,
    DrivingLog,
    LidarStream,
    LidarSweep,
    Track,
    Trajectory,
)

BOX_BESIDE = 30.0
"""Degrees between a vehicle's motion and its box: labels of turning trucks are 20 off."""
LEAST_TURN = 5.0
"""Degrees: standard deviation of the way's direction from which turns are compared."""
SLOWEST = 2.0
"""Metres a second from which a direction of motion is measured: noise of 0.1 m is then 6 degrees
over `CHORD` seconds."""
CHORD = 0.5
"""Seconds over which a direction of motion is measured."""
MOST_STEPS = 100_000
"""Steps in which a trajectory is looked at, at most: half a second each in a drive of 14 hours."""
FASTEST_REVERSING = 4.0
"""Metres a second: a reverse gear at idle and a driver who looks back do less for a whole drive."""
WIDER = 1.1
"""Width over length from which a box counts as wider than long: labels are good to 10 %."""
FEWEST = 3
"""Tracks from which a share or median of tracks says something."""
JUMP = (2.0, 35.0)
"""Metres in one step, and metres a second beside the track's median velocity: a jump is above
both. Between 126 km/h and standing there are 4 s of full braking."""
FLIP = 140.0
"""Degrees between two labels within a second: the heading was flipped, nothing turns so fast."""
FLIPPING = (*VEHICLES, "tram", "trailer", "cyclist", "motorcyclist")
"""Categories that cannot turn on the spot."""
SAME_SCALE = 0.2
"""Relative difference of the principal point from the image's centre that lenses and crops have."""
SCALES = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0)
"""Factors by which people make images smaller."""
BOX_SLOWEST = 3.0
"""Metres a second from which a box's direction of motion is measured: labels wander by 0.5 m."""
REACH = 5.0
"""Metres that the ego moves within a turn of a LiDAR, at the most."""
NO_RANGE = 0.5
"""Metres from the sensor: LiDARs of vehicles measure from 0.5 or 1."""
SAMPLES = 3
"""Images of each camera and sweeps of each LiDAR that are looked at."""
_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Figures:
    """What was measured, in degrees, metres and seconds; None if nothing in the log measures it."""

    rig_lean: float  # median angle from the rig's z axis to the world's
    heading_off: float | None  # median angle between motion and heading, folded for reversing
    heading_off_worst: float | None  # the same angle, 90th percentile
    turning: float | None  # turn of the heading for each turn of the way; 1.0 for a car
    reversing: float | None  # share of the way that was driven backwards
    speed: float  # fastest speed over a second
    acceleration: float | None  # strongest horizontal acceleration over a second
    box_lean: float | None  # largest median lean of a track's box
    vehicles: int  # number of tracks of cars, vans, trucks and buses
    wider_than_long: int  # number of those whose box is wider than long
    moving: int  # number of vehicles whose direction of motion can be measured
    sideways: int  # number of those that move across their box's heading
    backwards: int  # number of those that move backwards fast
    jumps: int  # number of steps of tracks that nothing can do
    flips: int  # number of labels whose heading is opposite to that of most labels of their track
    # largest distance of a principal point from its image's centre, as a share of the image's width
    # or height; up to 0.25 is in the middle half.
    principal_point: float | None
    one_value: float | None = None  # share of the sampled images whose pixels all have one value
    # share of the sampled LiDAR points within 0.5 m of their sensor.
    near_points: float | None = None


def unflipped(trajectory: Trajectory) -> tuple[Trajectory, int]:
    """A track whose single labels face backwards, with those turned, and their number.

    The heading of most labels counts. Unchanged if half of the labels face either way.
    """
    turned = _flipped(trajectory)
    count = int(np.count_nonzero(turned))
    if not count or 2 * count == len(turned):
        return trajectory, 0
    poses = trajectory.poses.copy()
    poses[turned] = poses[turned] @ _HALF_TURN
    return replace(trajectory, poses=poses), count


def _flipped(trajectory: Trajectory) -> Array:
    """(T,) bool: labels that face opposite to most labels of the track."""
    forward = trajectory.poses[:, :2, 0]
    near = np.diff(trajectory.timestamps_us) <= 1_000_000
    cosine = np.sum(forward[:-1] * forward[1:], axis=1) / np.maximum(
        np.linalg.norm(forward[:-1], axis=1) * np.linalg.norm(forward[1:], axis=1), 1e-9
    )
    turns = near & (cosine < np.cos(np.radians(FLIP)))
    other = np.append(0, np.cumsum(turns)) % 2 == 1
    return ~other if np.count_nonzero(other) * 2 > len(other) else other


def image_scale(camera: PinholeCamera) -> float | None:
    """How many times as large as its images are those that a camera's intrinsics are for.

    A principal point lies near the image's centre. 1.0 for one in the middle half of the image;
    another factor where both axes agree on it; None where they do not.
    """
    ratio = np.array([2 * camera.cx / camera.width, 2 * camera.cy / camera.height])
    if np.all(np.abs(ratio - 1.0) <= 0.5):
        return 1.0
    factors = np.array([*SCALES, *(1 / scale for scale in SCALES)])
    off = np.abs(ratio / factors[:, None] - 1.0).max(axis=1)
    return float(factors[np.argmin(off)]) if off.min() <= SAME_SCALE else None


def rescaled(camera: PinholeCamera, factor: float) -> PinholeCamera:
    """Intrinsics for images whose sides are `factor` times as short as those that they are for."""
    parts = {name: getattr(camera, name) / factor for name in ("fx", "fy", "cx", "cy")}
    return replace(camera, **parts)


@dataclass(frozen=True)
class MotionFigures:
    """Chords (N,) of a trajectory where it moves: angle to the heading, and way ahead."""

    beside: Array  # degrees, folded for reversing
    ahead: Array  # metres a second along the heading, below zero backwards
    # turn of the heading for each turn of the way; None if the way is straight.
    turning: float | None

    @classmethod
    def of(cls, trajectory: Trajectory, slowest: float = SLOWEST) -> MotionFigures | None:
        """None where nothing moves."""
        seconds = duration(trajectory)
        if seconds <= 0:
            return None
        count = max(1, int(seconds / _step(trajectory, CHORD)))
        first, last = trajectory.timestamps_us[[0, -1]]
        times = np.linspace(first, last, count + 1).astype(np.int64)
        poses = trajectory.at(times)
        step = se3.inverse(poses[:-1]) @ poses[1:]
        # From the first pose a circular arc ends half its turn off the start's heading.
        angle = np.arctan2(step[:, 1, 3], step[:, 0, 3]) - se3.yaw(step) / 2
        way = np.linalg.norm(step[:, :2, 3], axis=1)
        fast = (way > slowest * np.diff(times) / 1e6) & (way > slowest * CHORD)
        if not np.any(fast):
            return None
        cosine = np.cos(angle[fast])
        beside = np.degrees(np.arccos(np.clip(np.abs(cosine), 0.0, 1.0)))
        turning = _turning((poses[1:] - poses[:-1])[fast], poses[:-1][fast])
        return cls(beside, cosine * way[fast] * count / seconds, turning)

    @property
    def reversing(self) -> float:
        """Share of the way that leads backwards."""
        return float(np.maximum(-self.ahead, 0.0).sum() / np.abs(self.ahead).sum())


def _turning(chords: Array, poses: Array) -> float | None:
    """Slope of the heading over the direction of the way, both folded for reversing."""
    course = np.unwrap(2 * np.arctan2(chords[:, 1, 3], chords[:, 0, 3])) / 2
    heading = np.unwrap(2 * se3.yaw(poses)) / 2
    if np.degrees(np.std(course)) < LEAST_TURN:
        return None
    return float(np.polyfit(course, heading, 1)[0])


def duration(trajectory: Trajectory) -> float:
    """Seconds from the first pose to the last."""
    return float(trajectory.timestamps_us[-1] - trajectory.timestamps_us[0]) / 1e6


def _step(trajectory: Trajectory, wanted: float) -> float:
    """Seconds of a step: as wanted, or longer where `MOST_STEPS` would not reach the end."""
    return max(wanted, duration(trajectory) / MOST_STEPS)


def _leans(poses: Array) -> Array:
    return np.degrees(np.arccos(np.clip(poses[:, 2, 2], -1.0, 1.0)))


def _places(trajectory: Trajectory, every: float) -> Array:
    """Places (N, 3) at steps of `every` seconds; the first and last of a shorter trajectory."""
    times = trajectory.timestamps_us
    grid = np.arange(times[0], times[-1] + 1, round(every * 1e6))
    places = trajectory.poses[:, :3, 3]
    return np.stack([np.interp(grid, times, places[:, axis]) for axis in range(3)], axis=1)


def _speed(trajectory: Trajectory) -> float:
    """Fastest speed over a second; over the whole drive if that is shorter."""
    seconds = duration(trajectory)
    if seconds >= 1.0:
        step = _step(trajectory, 0.5)
        places = _places(trajectory, step)
        ways = np.linalg.norm(places[2:] - places[:-2], axis=1)
        return float(ways.max(initial=0.0) / (2 * step))
    moved = np.linalg.norm(trajectory.poses[-1, :3, 3] - trajectory.poses[0, :3, 3])
    # Within a metre it may be noise of the positions.
    return float(moved / seconds) if moved > 1.0 else 0.0


def _acceleration(trajectory: Trajectory) -> float | None:
    step = _step(trajectory, 1.0)
    places = _places(trajectory, step)[:, :2]
    if len(places) < 3:
        return None
    return float(np.linalg.norm(np.diff(places, 2, axis=0), axis=1).max() / step**2)


@dataclass(frozen=True)
class TrackFigures:
    """One track: lean in degrees, steps that nothing can do and the largest in metres, flips."""

    track: Track
    lean: float
    jumps: int
    longest: float
    flips: int
    motion: MotionFigures | None

    @classmethod
    def of(cls, track: Track) -> TrackFigures:
        """Measure a track."""
        trajectory = track.trajectory
        vehicle = track.category in VEHICLES
        jumps, longest = _jumps(trajectory)
        return cls(
            track=track,
            lean=float(np.median(_leans(trajectory.poses))),
            jumps=jumps,
            longest=longest,
            flips=int(_flipped(trajectory).sum()) if track.category in FLIPPING else 0,
            motion=MotionFigures.of(trajectory, BOX_SLOWEST) if vehicle and not jumps else None,
        )

    @property
    def sideways(self) -> bool:
        """Whether the vehicle moves across its box's heading."""
        return self.motion is not None and float(np.median(self.motion.beside)) > BOX_BESIDE

    @property
    def backwards(self) -> bool:
        """Whether the vehicle moves backwards, faster than vehicles reverse."""
        return self.motion is not None and -float(np.median(self.motion.ahead)) > FASTEST_REVERSING

    @property
    def wide(self) -> bool:
        """Whether the box has sides that no vehicle has in this order."""
        length, width, height = self.track.size.tolist()
        high = self.track.category in ("car", "van") and height > length
        return self.track.category in VEHICLES and (high or width > WIDER * length)


def _jumps(trajectory: Trajectory) -> tuple[int, float]:
    """Number of jumps of a track, each of one or more steps, and the longest in metres."""
    if len(trajectory.timestamps_us) < 2:
        return 0, 0.0
    seconds = np.diff(trajectory.timestamps_us)[:, None] / 1e6
    steps = np.diff(trajectory.poses[:, :3, 3], axis=0)
    usual = np.median(steps / seconds, axis=0) if len(steps) >= FEWEST else np.zeros(3)
    off = steps - usual * seconds
    beside = np.linalg.norm(off, axis=1)
    jumps = (beside > JUMP[0]) & (beside > JUMP[1] * seconds[:, 0])
    begins = jumps & ~np.append(False, jumps[:-1])
    if not np.any(begins):
        return 0, 0.0
    lengths = [
        np.linalg.norm(np.cumsum(off[run], axis=0), axis=1).max()
        for run in np.split(np.flatnonzero(jumps), np.flatnonzero(begins[jumps])[1:])
    ]
    return len(lengths), float(max(lengths))


def off_centre(camera: PinholeCamera) -> float:
    """Distance of the principal point from the image's centre, in shares of its width or height."""
    x, y = camera.cx / camera.width - 0.5, camera.cy / camera.height - 0.5
    return float(max(abs(x), abs(y)))


def sampled(count: int) -> list[int]:
    """Up to `SAMPLES` indices of `count`, spread evenly."""
    return sorted({int(index) for index in np.linspace(0, count - 1, SAMPLES)}) if count else []


def near_points(log: DrivingLog, lidar: LidarStream, sweep: LidarSweep) -> int:
    """Number of points within `NO_RANGE` of the sensor, as measured, or of the rig's origin."""
    points, origin = sweep.points, lidar.rig_from_lidar[:3, 3]
    measured: Array = points.astype(np.float64)
    if sweep.point_timestamps_us is not None:
        # A ray without a return was moved with the ego, too.
        near = np.flatnonzero(np.linalg.norm(points - origin, axis=1) < REACH)
        times = sweep.point_timestamps_us[near]
        ego = log.world_from_rig
        times = np.clip(times, *ego.timestamps_us[[0, -1]])
        measured[near] = motion.distort(measured[near], times, ego, sweep.timestamp_us)
    close = np.linalg.norm(measured - origin, axis=1) < NO_RANGE
    return int(np.count_nonzero(close | np.all(points == 0, axis=1)))


def measured(log: DrivingLog) -> tuple[Figures, MotionFigures | None, list[TrackFigures]]:
    """Figures of a log without its images and sweeps; and its ego and tracks, which they sum up."""
    ego = MotionFigures.of(log.world_from_rig)
    tracks = [TrackFigures.of(track) for track in log.tracks.values()]
    figures = Figures(
        rig_lean=float(np.median(_leans(log.world_from_rig.poses))),
        heading_off=None if ego is None else float(np.median(ego.beside)),
        heading_off_worst=None if ego is None else float(np.percentile(ego.beside, 90)),
        turning=None if ego is None else ego.turning,
        reversing=None if ego is None else ego.reversing,
        speed=_speed(log.world_from_rig),
        acceleration=_acceleration(log.world_from_rig),
        box_lean=max((one.lean for one in tracks), default=None),
        vehicles=sum(one.track.category in VEHICLES for one in tracks),
        wider_than_long=sum(one.wide for one in tracks),
        moving=sum(one.motion is not None for one in tracks),
        sideways=sum(one.sideways for one in tracks),
        backwards=sum(one.backwards for one in tracks),
        jumps=sum(one.jumps for one in tracks),
        flips=sum(one.flips for one in tracks),
        principal_point=max((off_centre(one.camera) for one in log.cameras.values()), default=None),
    )
    return figures, ego, tracks
