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

from recast.arrays import Int64Array
from recast.core.errors import InputError
from recast.logs.checks import refused
from recast.logs.measuring import (
    FASTEST_REVERSING,
    FEWEST,
    FLIPPING,
    NO_RANGE,
    Figures,
    MotionFigures,
    TrackFigures,
    duration,
    image_scale,
    measured,
    near_points,
    off_centre,
    rescaled,
    sampled,
    unflipped,
)
from recast.logs.types import (
    VEHICLES,
    CameraStream,
    DrivingLog,
    Track,
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
CAR_LENGTHS = (0.3, 30.0)
"""Metres: median length of all cars; beyond, lengths are in another unit."""
LOW_CARS = 0.9
"""Median of width over height of a log's cars: sedans have 1.25, vans 1.0."""
ODD_ASPECT = 1.25
"""Ratio of the focal lengths, beyond which one axis of the images was resized alone."""
TURNED = 45.0
"""Degrees by which a camera's x axis may lean, and its y axis rise."""
SKY, GROUND = 45.0, -75.0
"""Degrees above the horizon of a camera's axis that deserve a look."""
MOST_NEAR = 0.05
"""Share of a sweep's points nearer than that: drops, dirt and the roof's edge are fewer."""
FLIPS_NOTE = "headings_turned"
"""Member of the metadata: tracks whose flipped headings were turned around at import."""
SCALE_NOTE = "intrinsics_scaled"
"""Member of the metadata: cameras whose intrinsics were scaled to their images at import."""


class OddLogWarning(UserWarning):
    """A log that can be used, but holds what a vehicle or sensor hardly does."""


@dataclass(frozen=True)
class Finding:
    """What is wrong in a log: the field, the problem with its value, and the likely mistake."""

    field: str
    problem: str
    hint: str


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
    figures, ego, tracks = measured(log)
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
    if len(times) >= FEWEST and (seconds := duration(log.world_from_rig)) > 0:
        if len(times) > max(MOST_POSES * seconds, 2 * FEWEST):
            rate = f"{(len(times) - 1) / seconds:,.0f} poses a second"
            yield _too_many("world_from_rig.timestamps_us", rate)
        if (pause := float(np.median(np.diff(times))) / 1e6) > LONGEST_PAUSE:
            yield _too_few("world_from_rig.timestamps_us", f"{pause:,.0f} s between poses")


def _too_many(field: str, rate: str) -> tuple[bool, Finding]:
    return True, Finding(field, rate, "are the times microseconds, or milliseconds or seconds?")


def _too_few(field: str, pause: str) -> tuple[bool, Finding]:
    return True, Finding(field, pause, "are the times microseconds, or nanoseconds?")


def _ego_findings(figures: Figures, ego: MotionFigures | None) -> Iterator[tuple[bool, Finding]]:
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


def _track_findings(tracks: Sequence[TrackFigures]) -> Iterator[tuple[bool, Finding]]:
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


def _size_findings(vehicles: Sequence[TrackFigures]) -> Iterator[tuple[bool, Finding]]:
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


def _name(track: TrackFigures) -> str:
    return f"track {track.track.track_id}"


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
        shown = [camera.images[index] for index in sampled(len(camera.images))]
        same = sum(bool(np.all(image == image[0, 0])) for image in shown)
        flat, images = flat + same, images + len(shown)
        if same:
            problem = f"{same} of {len(shown)} images looked at are of one colour"
            hint = "is the lens covered, or were 16 bits read as 8?"
            findings.append(Finding(f"cameras[{name!r}]", problem, hint))
    near = points = 0
    for name, lidar in log.lidars.items():
        sweeps = [lidar.sweeps[index] for index in sampled(len(lidar.sweeps))]
        close = sum(near_points(log, lidar, sweep) for sweep in sweeps)
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
