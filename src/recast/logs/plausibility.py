"""What a vehicle and its sensors can do: checks that a well-formed log is also a possible one.

A value that is read in another unit, order or frame gives a log of the right form that no car could
have driven. Each check states its limit, why it is the limit, and the likely mistake. What is
impossible is refused; what is odd is a warning. The limits come from vehicles, roads and sensors,
and were not fitted to any log.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from recast.arrays import Array, Int64Array
from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import motion
from recast.logs.checks import refused
from recast.logs.types import (
    VEHICLES,
    CameraStream,
    DrivingLog,
    LidarStream,
    LidarSweep,
    Track,
    Trajectory,
)

STEEPEST = 25.0
"""Degrees that a rig or a box may lean. The steepest street (35 %) has 19; a car rolls by 5."""
MOST_BESIDE = 20.0
"""Degrees between motion and heading, at most: tyres slip by less, at the rear axle by 0."""
ODD_BESIDE = 8.0
"""Degrees between motion and heading that deserve a look: a mounting is good to 2."""
MOST_BESIDE_IN_TURNS = 45.0
"""Degrees between motion and heading in the worst tenth of the drive; a rig with its origin at the
front bumper has 35 in the tightest turn (3.8 m ahead of the axle, radius 5.5 m)."""
BOX_BESIDE = 30.0
"""Degrees between a vehicle's motion and its box: labels of turning trucks are 20 off."""
LEAST_TURN = 5.0
"""Degrees: standard deviation of the way's direction from which turns are compared."""
WRONG_TURN = -0.5
"""Turn of the heading for each turn of the way: a car has 1, a mirrored heading -1."""
FASTEST = 100.0
"""Metres a second over a second, at most: 360 km/h."""
ODD_SPEED = 60.0
"""Metres a second of a drive that deserve a look: 216 km/h."""
STRONGEST = 30.0
"""Metres a second squared over a second, at most: three times what tyres hold."""
ODD_ACCELERATION = 12.0
"""Metres a second squared over a second that deserve a look: good tyres hold 10."""
SLOWEST = 2.0
"""Metres a second from which a direction of motion is measured: noise of 0.1 m is then 6 degrees
over `CHORD` seconds."""
CHORD = 0.5
"""Seconds over which a direction of motion is measured."""
MOST_STEPS = 100_000
"""Steps in which a trajectory is looked at, at most: half a second each in a drive of 14 hours."""
FASTEST_REVERSING = 4.0
"""Metres a second: a reverse gear at idle and a driver who looks back do less for a whole drive."""
MOST_FRAMES = 500.0
"""Frames a second of a camera or LiDAR, at most; those of vehicles take 5 to 120."""
MOST_POSES = 5000.0
"""Poses a second: IMUs give 100 to 2000."""
LONGEST_PAUSE = 20.0
"""Seconds between frames or poses, at most: the slowest key frames are 1 apart."""
FARTHEST_SENSOR = 30.0
"""Metres from the rig's origin to a sensor, at most: longer than an articulated bus."""
ODD_SENSOR = 6.0
"""Metres from the rig's origin to the middle one of all sensors: cars have 2 to 3."""
UNDERGROUND = 0.3
"""Metres below the rig's origin, which is on the ground, of a sensor that deserves a look."""
WIDEST = 3.2
"""Metres of the median width of a log's cars: roads allow vehicles of 2.6, labels add mirrors."""
WIDER = 1.1
"""Width over length from which a box counts as wider than long: labels are good to 10 %."""
CAR_LENGTHS = (0.3, 30.0)
"""Metres: median length of all cars; beyond, lengths are in another unit."""
LOW_CARS = 0.9
"""Median of width over height of a log's cars: sedans have 1.25, vans 1.0."""
FEWEST = 3
"""Tracks from which a share or median of tracks says something."""
JUMP = (2.0, 35.0)
"""Metres in one step, and metres a second beside the track's median velocity: a jump is above
both. Between 126 km/h and standing there are 4 s of full braking."""
FLIP = 140.0
"""Degrees between two labels within a second: the heading was flipped, nothing turns so fast."""
FLIPPING = (*VEHICLES, "tram", "cyclist")
"""Categories that cannot turn on the spot."""
SAME_SCALE = 0.2
"""Relative difference of the principal point from the image's centre that lenses and crops have."""
SCALES = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0)
"""Factors by which people make images smaller."""
ODD_ASPECT = 1.25
"""Ratio of the focal lengths, beyond which one axis of the images was resized alone."""
TURNED = 45.0
"""Degrees by which a camera's x axis may lean, and its y axis rise."""
BOX_SLOWEST = 3.0
"""Metres a second from which a box's direction of motion is measured: labels wander by 0.5 m."""
REACH = 5.0
"""Metres that the ego moves within a turn of a LiDAR, at the most."""
SKY, GROUND = 45.0, -75.0
"""Degrees above the horizon of a camera's axis that deserve a look."""
NO_RANGE = 0.5
"""Metres from the sensor: LiDARs of vehicles measure from 0.5 or 1."""
MOST_NEAR = 0.05
"""Share of a sweep's points nearer than that: drops, dirt and the roof's edge are fewer."""
SAMPLES = 3
"""Images of each camera and sweeps of each LiDAR that are looked at."""
FLIPS_NOTE = "headings_turned"
"""Member of the metadata: tracks whose flipped headings were turned around at import."""
SCALE_NOTE = "intrinsics_scaled"
"""Member of the metadata: cameras whose intrinsics were scaled to their images at import."""

_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])


class OddLogWarning(UserWarning):
    """A log that can be used, but holds what a vehicle or sensor hardly does."""


@dataclass(frozen=True)
class Finding:
    """What is wrong in a log: the field, the problem with its value, and the likely mistake."""

    field: str
    problem: str
    hint: str


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


@dataclass(frozen=True)
class Plausibility:
    """The answer to whether a vehicle can have recorded a log.

    Attributes:
        figures: what was measured.
        impossible: reasons to refuse the log, the most telling first.
        odd: what deserves a look.
    """

    figures: Figures
    impossible: tuple[Finding, ...]
    odd: tuple[Finding, ...]

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is odd, a sentence each."""
        return tuple(f"{one.field}: {one.problem}; {one.hint}" for one in self.odd)


def plausibility(log: DrivingLog, sensors: bool = True) -> Plausibility:
    """Measure a valid log and compare it with what a vehicle can do.

    Args:
        sensors: whether to look at some images and sweeps, too, which are decoded for it.

    Raises:
        InputError: an image or sweep cannot be read.
    """
    ego = _Motion.of(log.world_from_rig)
    tracks = [_TrackFigures.of(track) for track in log.tracks.values()]
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
    rated = [*_time_findings(log), *_ego_findings(figures, ego), *_mount_findings(log)]
    rated += _track_findings(tracks)
    for name, stream in log.cameras.items():
        rated += _camera_findings(name, stream)
    impossible = [finding for refuse, finding in rated if refuse]
    odd = [finding for refuse, finding in rated if not refuse]
    for note, said in ((FLIPS_NOTE, "flipped headings"), (SCALE_NOTE, "intrinsics too large")):
        if note in log.metadata:
            odd.append(Finding(note, f"{said}: {log.metadata[note]}", "corrected at import"))
    if sensors:
        figures, findings = _sensor_findings(log, figures)
        odd += findings
    return Plausibility(figures, tuple(impossible), tuple(odd))


def require_plausible(log: DrivingLog, where: str | Path, mend: str) -> None:
    """Refuse a log that is not valid, or that no vehicle can have recorded.

    Args:
        where: file or folder of the log, for the message.
        mend: what the user can do about an invalid value.

    Raises:
        InputError: see `DrivingLog.validate` and `plausibility`.
    """
    with refused(where, mend):
        log.validate()
    for finding in plausibility(log, sensors=False).impossible:
        raise InputError(where, finding.field, finding.problem, finding.hint)


def examined(log: DrivingLog, root: Path) -> DrivingLog:
    """The log of an importer, corrected where the mistake is certain.

    Flipped headings are turned around if most labels of the track agree; intrinsics are scaled to
    the images if both axes agree on the factor. The log's metadata says which.

    Args:
        log: log that the importer made.
        root: dataset's folder, for messages.

    Raises:
        InputError: see `require_plausible`.
    """
    where, mend = f"{root}: log {log.name}", "use the dataset's files as published"
    with refused(where, mend):
        log.validate()
    log = _corrected(log)
    require_plausible(log, where, mend)
    return log


def _corrected(log: DrivingLog) -> DrivingLog:
    tracks, notes = turned_around(log.tracks)
    cameras, scaled = dict(log.cameras), []
    for name, stream in log.cameras.items():
        factor = image_scale(stream.camera)
        if factor is not None and factor != 1.0:
            cameras[name] = replace(stream, camera=rescaled(stream.camera, factor))
            scaled.append(f"{name} by {1 / factor:g}")
    if scaled:
        notes[SCALE_NOTE] = ", ".join(scaled)
    if not notes:
        return log
    return replace(log, tracks=tracks, cameras=cameras, metadata={**log.metadata, **notes})


def turned_around(tracks: Mapping[str, Track]) -> tuple[dict[str, Track], dict[str, str]]:
    """Tracks with flipped headings turned around (`unflipped`), and what the metadata says of it.

    Pedestrians may turn on the spot and stay as they are.
    """
    result, turned = dict(tracks), []
    for name, track in tracks.items():
        if track.category in FLIPPING:
            trajectory, flips = unflipped(track.trajectory)
            if flips:
                result[name] = replace(track, trajectory=trajectory)
                turned.append(f"{flips} of {len(trajectory.timestamps_us)} labels of {name}")
    return result, {FLIPS_NOTE: ", ".join(turned)} if turned else {}


def warn_odd(log: DrivingLog) -> None:
    """Send an `OddLogWarning` for everything odd in a log; images and sweeps are not read."""
    for sentence in plausibility(log, sensors=False).warnings:
        warnings.warn(f"log {log.name}: {sentence}", OddLogWarning, stacklevel=3)


def unflipped(trajectory: Trajectory) -> tuple[Trajectory, int]:
    """A track whose single labels face backwards, with those turned, and their number.

    The heading of most labels counts. Unchanged if half of the labels face either way.
    """
    flipped = _flipped(trajectory)
    count = int(np.count_nonzero(flipped))
    if not count or 2 * count == len(flipped):
        return trajectory, 0
    poses = trajectory.poses.copy()
    poses[flipped] = poses[flipped] @ _HALF_TURN
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
class _Motion:
    """Chords (N,) of a trajectory where it moves: angle to the heading, and way ahead."""

    beside: Array  # degrees, folded for reversing
    ahead: Array  # metres a second along the heading, below zero backwards
    # turn of the heading for each turn of the way; None if the way is straight.
    turning: float | None

    @classmethod
    def of(cls, trajectory: Trajectory, slowest: float = SLOWEST) -> _Motion | None:
        """None where nothing moves."""
        seconds = _seconds(trajectory)
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


def _seconds(trajectory: Trajectory) -> float:
    return float(trajectory.timestamps_us[-1] - trajectory.timestamps_us[0]) / 1e6


def _step(trajectory: Trajectory, wanted: float) -> float:
    """Seconds of a step: as wanted, or longer where `MOST_STEPS` would not reach the end."""
    return max(wanted, _seconds(trajectory) / MOST_STEPS)


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
    seconds = _seconds(trajectory)
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


def _time_findings(log: DrivingLog) -> Iterator[tuple[bool, Finding]]:
    """Sensors that take too many or too few frames a second."""
    streams: list[tuple[str, Int64Array]] = [
        *((f"cameras[{name!r}]", one.timestamps_us) for name, one in log.cameras.items()),
        *((f"lidars[{name!r}]", one.timestamps_us) for name, one in log.lidars.items()),
    ]
    for field, times in streams:
        if len(times) >= FEWEST and (pause := float(np.median(np.diff(times))) / 1e6) > 0:
            if pause * MOST_FRAMES < 1:
                yield _too_many(f"{field}.timestamps_us", f"{1 / pause:,.0f} frames a second")
            if pause > LONGEST_PAUSE:
                yield _too_few(f"{field}.timestamps_us", f"{pause:,.0f} s between frames")
    times = log.world_from_rig.timestamps_us
    if len(times) >= FEWEST and (seconds := _seconds(log.world_from_rig)) > 0:
        if len(times) > max(MOST_POSES * seconds, 2 * FEWEST):
            rate = f"{(len(times) - 1) / seconds:,.0f} poses a second"
            yield _too_many("world_from_rig.timestamps_us", rate)
        if (pause := float(np.median(np.diff(times))) / 1e6) > LONGEST_PAUSE:
            yield _too_few("world_from_rig.timestamps_us", f"{pause:,.0f} s between poses")


def _too_many(field: str, rate: str) -> tuple[bool, Finding]:
    return True, Finding(field, rate, "are the times microseconds, or milliseconds or seconds?")


def _too_few(field: str, pause: str) -> tuple[bool, Finding]:
    return True, Finding(field, pause, "are the times microseconds, or nanoseconds?")


def _ego_findings(figures: Figures, ego: _Motion | None) -> Iterator[tuple[bool, Finding]]:
    field = "world_from_rig"
    lean = figures.rig_lean
    if lean > STEEPEST:
        hint = "are quaternions wxyz?" if lean < 150 else "are z axes up, and quaternions wxyz?"
        problem = f"the rig leans by {lean:.0f} degrees from the world's up"
        yield True, Finding(field, problem, hint)
    if figures.speed > FASTEST:
        problem = f"the rig drives {figures.speed:,.0f} m/s over a second"
        hint = "are the times microseconds, and lengths metres?"
        yield True, Finding(field, problem, hint)
    elif figures.speed > ODD_SPEED:
        problem = f"the rig drives {figures.speed:.0f} m/s"
        yield False, Finding(field, problem, "are lengths metres, or feet?")
    if figures.acceleration is not None and figures.speed <= FASTEST:
        problem = f"the rig accelerates by {figures.acceleration:.0f} m/s² over a second"
        if figures.acceleration > ODD_ACCELERATION:
            hint = "do positions jump, and are lengths metres?"
            yield figures.acceleration > STRONGEST, Finding(field, problem, hint)
    if ego is None or figures.heading_off is None or figures.heading_off_worst is None:
        return
    median, worst = figures.heading_off, figures.heading_off_worst
    if median > MOST_BESIDE or worst > MOST_BESIDE_IN_TURNS:
        shown = median if median > MOST_BESIDE else worst
        problem = f"the rig faces {shown:.0f} degrees away from its direction of motion"
        yield True, Finding(field, problem, _facing_hint(median))
    elif figures.turning is not None and figures.turning < WRONG_TURN:
        problem = "the rig turns right while its path turns left"
        yield True, Finding(field, problem, _facing_hint(median))
    elif median > ODD_BESIDE:
        problem = f"the rig faces {median:.0f} degrees away from its direction of motion"
        yield False, Finding(field, problem, "is the yaw of the rig's mounting right?")
    backwards = -float(np.median(ego.ahead))
    if ego.reversing > 0.5 and backwards > FASTEST_REVERSING:
        problem = f"the rig moves backwards at {backwards:.0f} m/s"
        hint = "are poses world_from_rig, with x forward and quaternions wxyz?"
        yield False, Finding(field, problem, hint)


def _facing_hint(median: float) -> str:
    if median > 80:
        return "is x the forward axis of the rig?"
    return (
        "is the yaw counter-clockwise from east, in radians, are poses world_from_rig (not "
        "inverted), latitude before longitude, and quaternions wxyz?"
    )


def _mount_findings(log: DrivingLog) -> Iterator[tuple[bool, Finding]]:
    mounts = {
        **{f"cameras[{name!r}]": one.rig_from_camera for name, one in log.cameras.items()},
        **{f"lidars[{name!r}]": one.rig_from_lidar for name, one in log.lidars.items()},
    }
    if not mounts:
        return
    away = {field: float(np.linalg.norm(mount[:3, 3])) for field, mount in mounts.items()}
    farthest = max(away, key=lambda field: away[field])
    middle = float(np.median(list(away.values())))
    hint = "are lengths metres, or feet, centimetres or millimetres?"
    if away[farthest] > FARTHEST_SENSOR:
        problem = f"its mounting is {away[farthest]:,.0f} m from the rig's origin"
        yield True, Finding(farthest, problem, hint)
    elif middle > ODD_SENSOR:
        problem = f"the sensors are mounted {middle:.1f} m from the rig's origin"
        yield False, Finding("sensors", problem, hint)
    below = {field: -mount[2, 3] for field, mount in mounts.items()}
    deepest = max(below, key=lambda field: below[field])
    if below[deepest] > UNDERGROUND and away[deepest] <= FARTHEST_SENSOR:
        problem = f"is mounted {below[deepest]:.1f} m below the ground"
        hint = "is the rig's z axis up, and its origin on the ground under the rear axle?"
        yield False, Finding(deepest, problem, hint)


@dataclass(frozen=True)
class _TrackFigures:
    """One track: lean in degrees, steps that nothing can do and the largest in metres, flips."""

    track: Track
    lean: float
    jumps: int
    longest: float
    flips: int
    motion: _Motion | None

    @classmethod
    def of(cls, track: Track) -> _TrackFigures:
        trajectory = track.trajectory
        vehicle = track.category in VEHICLES
        jumps, longest = _jumps(trajectory)
        return cls(
            track=track,
            lean=float(np.median(_leans(trajectory.poses))),
            jumps=jumps,
            longest=longest,
            flips=int(_flipped(trajectory).sum()) if track.category in FLIPPING else 0,
            motion=_Motion.of(trajectory, BOX_SLOWEST) if vehicle and not jumps else None,
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


def _track_findings(tracks: Sequence[_TrackFigures]) -> Iterator[tuple[bool, Finding]]:
    leaning = [one for one in tracks if one.lean > STEEPEST]
    if leaning:
        worst = max(leaning, key=lambda one: one.lean)
        problem = f"{_of(leaning, tracks)} lean, {_name(worst)} by {worst.lean:.0f} degrees"
        hint = "are quaternions wxyz, and z axes up?"
        yield len(leaning) >= max(FEWEST, len(tracks) / 2), Finding("tracks", problem, hint)
    vehicles = [one for one in tracks if one.track.category in VEHICLES]
    yield from _size_findings(vehicles)
    moving = [one for one in vehicles if one.motion is not None]
    sideways = [one for one in moving if one.sideways]
    if sideways:
        beside = max(float(np.median(one.motion.beside)) for one in sideways if one.motion)
        problem = f"{_of(sideways, moving)} in motion face up to {beside:.0f} degrees away from it"
        hint = "is x the forward axis of the boxes, and their yaw in radians, in the world?"
        yield len(sideways) >= max(FEWEST, len(moving) / 2), Finding("tracks", problem, hint)
    backwards = [one for one in moving if one.backwards]
    if backwards:
        problem = f"{_of(backwards, moving)} in motion move backwards"
        hint = "do the boxes face the other way, or are the poses of the rig inverted?"
        yield False, Finding("tracks", problem, hint)
    jumping = [one for one in tracks if one.jumps]
    if jumping:
        worst = max(jumping, key=lambda one: one.longest)
        count = sum(one.jumps for one in jumping)
        problem = f"{_of(jumping, tracks)} jump ({count} jumps), {_name(worst)} by "
        problem += f"{worst.longest:.0f} m"
        hint = "does one id stand for several objects, or are boxes in another frame?"
        yield False, Finding("tracks", problem, hint)
    flipping = [one for one in tracks if one.flips]
    if flipping:
        count = sum(one.flips for one in flipping)
        problem = (
            f"{_of(flipping, tracks)} turn around from one label to the next, {count} labels in all"
        )
        yield False, Finding("tracks", problem, "correct the headings: front and rear are swapped")


def _size_findings(vehicles: Sequence[_TrackFigures]) -> Iterator[tuple[bool, Finding]]:
    wide = [one for one in vehicles if one.wide]
    if wide:
        length, width, height = wide[0].track.size.tolist()
        problem = f"{_of(wide, vehicles)} are wider or higher than they are long"
        problem += f" ({length:.1f} x {width:.1f} x {height:.1f} m)"
        hint = "are sizes length, width, height, in metres?"
        yield False, Finding("tracks", problem, hint)
    cars = np.array([one.track.size for one in vehicles if one.track.category == "car"])
    if not len(cars):
        return
    length = float(np.median(cars[:, 0]))
    if not CAR_LENGTHS[0] <= length <= CAR_LENGTHS[1]:
        problem = f"cars are {length:.3g} m long"
        yield True, Finding("tracks", problem, "are sizes metres, and not cm, mm or feet?")
    elif len(cars) >= FEWEST and (width := float(np.median(cars[:, 1]))) > WIDEST:
        problem = f"cars are {length:.1f} m long and {width:.1f} m wide"
        yield False, Finding("tracks", problem, "are sizes metres, or feet?")
    elif len(cars) >= FEWEST and np.median(cars[:, 1] / cars[:, 2]) < LOW_CARS:
        problem = "most cars are higher than wide"
        yield False, Finding("tracks", problem, "are sizes length, width, height?")


def _of(some: Sequence[object], every: Sequence[object]) -> str:
    return f"{len(some)} of {len(every)} tracks"


def _name(track: _TrackFigures) -> str:
    return f"track {track.track.track_id}"


def off_centre(camera: PinholeCamera) -> float:
    """Distance of the principal point from the image's centre, in shares of its width or height."""
    x, y = camera.cx / camera.width - 0.5, camera.cy / camera.height - 0.5
    return float(max(abs(x), abs(y)))


def _camera_findings(name: str, stream: CameraStream) -> Iterator[tuple[bool, Finding]]:
    field, camera = f"cameras[{name!r}]", stream.camera
    x, y = 2 * camera.cx / camera.width, 2 * camera.cy / camera.height
    if off_centre(camera) > 0.25:
        problem = f"the principal point {camera.cx:.0f}, {camera.cy:.0f} is not in the middle half"
        problem += f" of {camera.width} x {camera.height} px"
        hint = "are intrinsics and images of the same size?"
        outside = not (0 < x < 2 and 0 < y < 2)
        yield outside or image_scale(camera) is not None, Finding(field, problem, hint)
    if not 1 / ODD_ASPECT <= camera.fx / camera.fy <= ODD_ASPECT:
        problem = f"focal lengths differ: {camera.fx:.0f} and {camera.fy:.0f} px"
        yield False, Finding(field, problem, "was one axis of the images resized?")
    # Heights of the camera's axes (x right, y down, z ahead) in the rig.
    right, down, ahead = np.degrees(np.arcsin(np.clip(stream.rig_from_camera[2, :3], -1.0, 1.0)))
    hint = "is the mounting rig_from_camera, of a camera with x right, y down, z forward?"
    if ahead > SKY:
        yield False, Finding(field, f"looks {ahead:.0f} degrees up into the sky", hint)
    elif ahead < GROUND:
        yield False, Finding(field, f"looks {-ahead:.0f} degrees down at the ground", hint)
    elif abs(right) > TURNED and abs(right) > abs(down):
        yield False, Finding(field, f"is turned by {abs(right):.0f} degrees around its axis", hint)
    elif down > TURNED:
        yield False, Finding(field, "is mounted upside down", hint)


def _sensor_findings(log: DrivingLog, figures: Figures) -> tuple[Figures, list[Finding]]:
    """Look at `SAMPLES` images and sweeps of each sensor."""
    findings = []
    flat = images = 0
    for name, camera in log.cameras.items():
        sampled = [camera.images[index] for index in _sampled(len(camera.images))]
        same = sum(bool(np.all(image == image[0, 0])) for image in sampled)
        flat, images = flat + same, images + len(sampled)
        if same:
            problem = f"{same} of {len(sampled)} images looked at are of one colour"
            hint = "is the lens covered, or were 16 bits read as 8?"
            findings.append(Finding(f"cameras[{name!r}]", problem, hint))
    near = points = 0
    for name, lidar in log.lidars.items():
        sweeps = [lidar.sweeps[index] for index in _sampled(len(lidar.sweeps))]
        close = sum(_near_points(log, lidar, sweep) for sweep in sweeps)
        count = sum(len(sweep.points) for sweep in sweeps)
        near, points = near + close, points + count
        if close > MOST_NEAR * count:
            problem = f"{close / count:.0%} of the points are within {NO_RANGE} m of the sensor"
            hint = "do points (0, 0, 0) stand for rays without a return? leave them out"
            findings.append(Finding(f"lidars[{name!r}]", problem, hint))
    return replace(
        figures,
        one_value=flat / images if images else None,
        near_points=near / points if points else None,
    ), findings


def _sampled(count: int) -> list[int]:
    """Up to `SAMPLES` indices of `count`, spread evenly."""
    return sorted({int(index) for index in np.linspace(0, count - 1, SAMPLES)}) if count else []


def _near_points(log: DrivingLog, lidar: LidarStream, sweep: LidarSweep) -> int:
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
