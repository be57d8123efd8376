"""Cheap drives without a street, and the faults that recordings come with, each as a function.

A drive has an ego on a curved, hilly road, traffic that follows, comes towards it and is parked,
people, three cameras and a LiDAR. Fields that no fault touches are shared between the logs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.logs import CameraStream, DrivingLog, LidarStream, LidarSweep, Track, Trajectory

Mutation = Callable[[DrivingLog], DrivingLog]
START_US = 1_600_000_000_000_000
FORWARD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation from a camera that looks ahead (x right, y down, z forward) to the rig."""
TRAFFIC = {
    "lead": ("car", (4.5, 1.8, 1.5), 14.0, 0.0),
    "oncoming": ("car", (4.2, 1.75, 1.45), 60.0, 3.5),
    "bus": ("bus", (18.0, 2.55, 3.2), 35.0, 3.5),
    "parked": ("car", (4.7, 1.9, 1.6), 25.0, -3.0),
    "van": ("van", (5.3, 2.0, 2.2), 45.0, 0.0),
    "trailer": ("truck", (2.6, 2.3, 1.1), 53.0, 0.0),
    "walk": ("pedestrian", (0.6, 0.7, 1.7), 20.0, -6.0),
}
"""Category, size, metres ahead of the ego's start and metres to the left of its path."""


def drive(
    seed: int = 0,
    speed: float = 9.0,
    turn: float = 0.06,
    seconds: float = 8.0,
    grade: float = 0.03,
    heading: float | None = None,
) -> DrivingLog:
    """A drive at `speed` (m/s; below zero in reverse) with `turn` rad/s up a `grade`."""
    rng = np.random.default_rng(seed)
    heading = rng.uniform(0.4, 0.9) if heading is None else heading
    count = int(seconds * 10) + 1
    times = START_US + 100_000 * np.arange(count, dtype=np.int64)
    t = (times - START_US) / 1e6
    ego = Trajectory(times, _on_road(speed * t, 0.0, heading, turn / max(abs(speed), 5.0), grade))
    tracks = {}
    for name, (category, size, ahead, left) in TRAFFIC.items():
        rates = {"oncoming": -8.0, "parked": 0.0, "walk": 1.2}
        along = ahead + rates.get(name, 0.9 * abs(speed)) * t
        poses = _on_road(along, left, heading, turn / max(abs(speed), 5.0), grade)
        if name == "oncoming":
            poses = poses @ se3.from_rotation_translation(se3.rotation_z(np.pi), np.zeros(3))
        poses = poses @ se3.from_rotation_translation(np.eye(3), [0.0, 0.0, size[2] / 2])
        poses[:, :3, 3] += rng.normal(0.0, 0.03, (count, 3))
        tracks[name] = Track(name, category, np.array(size), Trajectory(times, poses))
    shots = times[::10]
    images = [rng.integers(0, 256, (20, 32, 3), dtype=np.uint8) for _ in shots]
    cameras = {}
    for name, yaw in (("left", 0.8), ("front", 0.0), ("right", -0.8)):
        mount = se3.from_rotation_translation(se3.rotation_z(yaw) @ FORWARD, [1.5, yaw / 5, 2.0])
        camera = PinholeCamera(32, 20, 30.0, 30.0, 16.3, 9.6)
        cameras[name] = CameraStream(name, camera, mount, shots, images)
    mount = se3.from_rotation_translation(np.eye(3), [1.4, 0.0, 2.1])
    rays = rng.normal(size=(400, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    points = (mount[:3, 3] + rays * rng.uniform(2.0, 60.0, (400, 1))).astype(np.float32)
    grey = np.full(400, 0.5, np.float32)
    sweeps = [LidarSweep(int(time), points, grey) for time in times]
    lidars = {"top": LidarStream("top", mount, times, sweeps)}
    return DrivingLog(f"drive {seed}", cameras, lidars, ego, tracks)


def _on_road(along: np.ndarray, left: float, heading: float, bend: float, grade: float):
    """Poses (N, 4, 4) on a road that bends by `bend` rad/m and climbs by `grade`."""
    fine = np.linspace(min(along.min(), 0.0), max(along.max(), 1.0), 4000)
    yaw = heading + bend * fine
    step = np.gradient(fine)
    x, y = np.cumsum(np.cos(yaw) * step), np.cumsum(np.sin(yaw) * step)
    start = np.array([np.interp(0.0, fine, x), np.interp(0.0, fine, y)])
    turned = heading + bend * along
    place = np.stack(
        [
            np.interp(along, fine, x) - start[0] - left * np.sin(turned),
            np.interp(along, fine, y) - start[1] + left * np.cos(turned),
            grade * along,
        ],
        axis=1,
    )
    slope = np.arctan(grade)
    pitch = np.array(
        [[np.cos(slope), 0, -np.sin(slope)], [0, 1, 0], [np.sin(slope), 0, np.cos(slope)]]
    )
    return se3.from_rotation_translation(se3.rotation_z(turned) @ pitch, place)


def with_ego(log: DrivingLog, poses: np.ndarray) -> DrivingLog:
    """The log with other ego poses; boxes, which are labelled in the rig, go with it."""
    ego = replace(log.world_from_rig, poses=poses)
    change = poses @ se3.inverse(log.world_from_rig.poses)
    return with_boxes(replace(log, world_from_rig=ego), lambda boxes: change @ boxes)


def with_boxes(log: DrivingLog, change: Callable[[np.ndarray], np.ndarray]) -> DrivingLog:
    """The log with the poses of every track changed."""
    return _tracks(
        log,
        lambda t: replace(t, trajectory=replace(t.trajectory, poses=change(t.trajectory.poses))),
    )


def _tracks(log: DrivingLog, change: Callable[[Track], Track]) -> DrivingLog:
    return replace(log, tracks={name: change(track) for name, track in log.tracks.items()})


def _sizes(scale: float = 1.0, order: tuple[int, int, int] = (0, 1, 2)) -> Mutation:
    return lambda log: _tracks(log, lambda t: replace(t, size=scale * t.size[list(order)]))


def _cameras(change: Callable[[CameraStream], CameraStream]) -> Mutation:
    return lambda log: replace(log, cameras={n: change(one) for n, one in log.cameras.items()})


def _turned_cameras(camera_turn: np.ndarray) -> Mutation:
    turn = se3.from_rotation_translation(camera_turn, np.zeros(3))
    return _cameras(lambda one: replace(one, rig_from_camera=one.rig_from_camera @ turn))


def _intrinsics(**factors: float) -> Mutation:
    def change(one: CameraStream) -> CameraStream:
        scaled = {name: getattr(one.camera, name) * by for name, by in factors.items()}
        return replace(one, camera=replace(one.camera, **scaled))

    return _cameras(change)


def _scaled_intrinsics(by: float) -> Mutation:
    return _intrinsics(fx=by, fy=by, cx=by, cy=by)


def _xyzw(poses: np.ndarray) -> np.ndarray:
    """Rotations whose quaternions were written wxyz and are read as xyzw, or the other way."""
    quats = se3.matrix_to_quat(poses[:, :3, :3])
    wrong = poses.copy()
    wrong[:, :3, :3] = se3.quat_to_matrix(np.roll(quats, 1, axis=1))
    return wrong


def _yaws(poses: np.ndarray, change: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    wrong = poses.copy()
    wrong[:, :3, :3] = se3.rotation_z(change(se3.yaw(poses)))
    return wrong


def _places(poses: np.ndarray, change: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    wrong = poses.copy()
    wrong[:, :3, 3] = change(poses[:, :3, 3])
    return wrong


def _ego(change: Callable[[np.ndarray], np.ndarray]) -> Mutation:
    return lambda log: with_ego(log, change(log.world_from_rig.poses))


def _boxes(change: Callable[[np.ndarray], np.ndarray]) -> Mutation:
    return lambda log: with_boxes(log, change)


def _right(rotation: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Another naming of the body's axes."""
    turn = se3.from_rotation_translation(rotation, np.zeros(3))
    return lambda poses: poses @ turn


def _times(numerator: int, denominator: int = 1) -> Mutation:
    def scaled(times: np.ndarray) -> np.ndarray:
        return START_US + (times - START_US) * numerator // denominator

    def change(log: DrivingLog) -> DrivingLog:
        def trajectory(one: Trajectory) -> Trajectory:
            return replace(one, timestamps_us=scaled(one.timestamps_us))

        log = _tracks(log, lambda t: replace(t, trajectory=trajectory(t.trajectory)))
        cameras = {
            n: replace(one, timestamps_us=scaled(one.timestamps_us))
            for n, one in log.cameras.items()
        }
        lidars = {
            n: replace(one, timestamps_us=scaled(one.timestamps_us))
            for n, one in log.lidars.items()
        }
        ego = trajectory(log.world_from_rig)
        return replace(log, cameras=cameras, lidars=lidars, world_from_rig=ego)

    return change


def _standing(log: DrivingLog) -> DrivingLog:
    ego = log.world_from_rig
    return replace(
        log, world_from_rig=replace(ego, poses=np.repeat(ego.poses[:1], len(ego.poses), 0))
    )


def _scaled_world(by: float) -> Mutation:
    """Every length but the boxes' in another unit."""

    def change(log: DrivingLog) -> DrivingLog:
        log = _ego(lambda poses: _places(poses, lambda places: places * by))(log)
        log = _boxes(lambda poses: _places(poses, lambda places: places * by))(log)
        return _mounts(by)(log)

    return change


def _mounts(by: float) -> Mutation:
    return _cameras(
        lambda one: replace(
            one, rig_from_camera=_places(one.rig_from_camera[None], lambda p: p * by)[0]
        )
    )


def _of_one(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Mutation:
    def mutate(log: DrivingLog) -> DrivingLog:
        track = log.tracks[name]
        trajectory = replace(track.trajectory, poses=change(track.trajectory.poses))
        return replace(log, tracks={**log.tracks, name: replace(track, trajectory=trajectory)})

    return mutate


def _moved(labels: slice, metres: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(poses: np.ndarray) -> np.ndarray:
        wrong = poses.copy()
        wrong[labels, 0, 3] += metres
        return wrong

    return change


def flipped(labels: slice) -> Callable[[np.ndarray], np.ndarray]:
    """Poses whose headings are opposite at some labels."""

    def change(poses: np.ndarray) -> np.ndarray:
        wrong = poses.copy()
        wrong[labels] = wrong[labels] @ np.diag([-1.0, -1.0, 1.0, 1.0])
        return wrong

    return change


def _points(change: Callable[[np.ndarray], np.ndarray]) -> Mutation:
    def mutate(log: DrivingLog) -> DrivingLog:
        top = log.lidars["top"]
        sweeps = [replace(one, points=change(one.points)) for one in top.sweeps]
        return replace(log, lidars={"top": replace(top, sweeps=sweeps)})

    return mutate


def _without_returns(at: tuple[float, float, float]) -> Mutation:
    def change(points: np.ndarray) -> np.ndarray:
        wrong = points.copy()
        wrong[::8] = at
        return wrong

    return _points(change)


def _chain(*mutations: Mutation) -> Mutation:
    def mutate(log: DrivingLog) -> DrivingLog:
        for mutation in mutations:
            log = mutation(log)
        return log

    return mutate


_Z = se3.rotation_z
_HALF_X = np.diag([1.0, -1.0, -1.0])
_FLU = FORWARD.T
_DOWN = se3.from_rotation_translation(_HALF_X, np.zeros(3))

REFUSED: dict[str, tuple[Mutation, str]] = {
    "ego quaternions xyzw": (_ego(_xyzw), "leans by .* wxyz"),
    "ego poses inverted": (_ego(se3.inverse), "faces .* inverted"),
    "compass yaw": (_ego(lambda p: _yaws(p, lambda yaw: np.pi / 2 - yaw)), "turns right .* yaw"),
    "yaw in degrees": (_ego(lambda p: _yaws(p, np.degrees)), "faces .* radians"),
    "latitude and longitude exchanged": (
        _ego(lambda p: _places(p, lambda xyz: xyz[:, [1, 0, 2]])),
        "(faces|turns right) .* latitude",
    ),
    "milliseconds": (_times(1, 1000), "frames a second; .* milliseconds"),
    "nanoseconds": (_times(1000), "s between frames; .* nanoseconds"),
    "milliseconds, standing": (_chain(_standing, _times(1, 1000)), "frames a second"),
    "nanoseconds, standing": (_chain(_standing, _times(1000)), "s between frames"),
    "tenths of milliseconds": (_times(1, 100), "1,000 frames a second"),
    "centimetres": (_scaled_world(100.0), "m/s over a second; .* metres"),
    "millimetres": (_scaled_world(1000.0), "is not within 1e.07 m"),
    "centimetres, standing": (_chain(_scaled_world(100.0), _standing), "mounting is .* centim"),
    "y forward": (_ego(_right(_Z(np.pi / 2))), "faces 90 .* forward axis"),
    "z down": (_ego(_right(_HALF_X)), "leans by 17. degrees"),
    "x up": (_ego(_right(np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]))), "leans by 8"),
    "left-handed": (_ego(lambda p: p @ np.diag([1.0, -1.0, 1.0, 1.0])), "mirror image"),
    "ego jumps": (_ego(_moved(slice(30, 60), 60.0)), "accelerates by .* jump"),
    "box quaternions xyzw": (_boxes(_xyzw), "tracks lean"),
    "boxes z down": (_boxes(_right(_HALF_X)), "tracks lean"),
    "boxes y forward": (_boxes(_right(_Z(np.pi / 2))), "face up to .* forward axis"),
    "box yaw in degrees": (
        _boxes(lambda p: _yaws(p, lambda yaw: np.degrees(yaw) + np.pi / 3)),
        "face up to .* radians",
    ),
    "sizes in centimetres": (_sizes(100.0), "cars are 450 m long|size: expected three sides"),
    "sizes in millimetres": (_sizes(1000.0), "size: expected three sides"),
    "one axis of the images halved": (_intrinsics(fx=2.0, cx=2.0), "principal point"),
    "intrinsics for another image": (_scaled_intrinsics(20.0), "principal point"),
}
"""What cannot be: the log with the fault, and what the refusal says."""

TOLD: dict[str, tuple[Mutation, str]] = {
    "rig x backwards": (_ego(_right(_Z(np.pi))), "moves backwards at 9 m/s"),
    "z down in rig and world": (
        _cameras(
            lambda one: replace(one, rig_from_camera=_DOWN @ one.rig_from_camera),
        ),
        "below the ground",
    ),
    "lengths in feet": (_scaled_world(1 / 0.3048), "feet"),
    "sizes in feet": (_sizes(1 / 0.3048), "cars are .* feet"),
    "length and width exchanged": (_sizes(order=(1, 0, 2)), "6 of 6 tracks are wider"),
    "length and height exchanged": (_sizes(order=(2, 1, 0)), "wider or higher than they are long"),
    "width and height exchanged": (_sizes(order=(0, 2, 1)), "higher than wide"),
    "a track that jumps": (_of_one("lead", _moved(slice(40, None), 40.0)), "lead by 40 m"),
    "a track with one label elsewhere": (_of_one("van", _moved(slice(9, 10), 40.0)), "by 40 m"),
    "headings half one way": (_of_one("lead", flipped(slice(0, None, 2))), "turned|turn around"),
    "all headings reversed": (_boxes(_right(_Z(np.pi))), "move backwards"),
    "cameras turned by 90 degrees": (_turned_cameras(_Z(np.pi / 2)), "turned by 90 degrees"),
    "cameras upside down": (_turned_cameras(_Z(np.pi)), "upside down"),
    "camera axes of the rig": (_turned_cameras(_FLU), "into the sky"),
    "cameras inverted": (
        _cameras(lambda one: replace(one, rig_from_camera=se3.inverse(one.rig_from_camera))),
        "turned by|below the ground",
    ),
    "rays without a return at the sensor": (_without_returns((1.4, 0.0, 2.1)), "12% of the points"),
    "rays without a return at the origin": (_without_returns((0.0, 0.0, 0.0)), "12% of the points"),
    "images of one value": (
        _cameras(lambda one: replace(one, images=[np.full((20, 32, 3), 255, np.uint8)] * 9)),
        "of one colour",
    ),
    "one focal length doubled": (_intrinsics(fx=2.0), "focal lengths differ"),
}
"""What is odd: the log with the fault, and what a warning says."""

CORRECTED: dict[str, Mutation] = {
    "images of half the size": _scaled_intrinsics(2.0),
    "images of a third of the size": _scaled_intrinsics(3.0),
    "images of twice the size": _scaled_intrinsics(0.5),
    "a flipped heading": _of_one("lead", flipped(slice(17, 18))),
    "flipped headings": _of_one("bus", flipped(slice(0, None, 4))),
}
"""What is certain: the importer's log is as without the fault, and a warning says so."""


def _half_turns(poses: np.ndarray) -> np.ndarray:
    return flipped(slice(5, None, 7))(poses)


GOOD: dict[str, Callable[[], DrivingLog]] = {
    "standing": lambda: _standing(drive()),
    "slow reversing": lambda: drive(speed=-2.8),
    "a loop": lambda: drive(speed=8.0, turn=0.8),
    "a U-turn": lambda: drive(speed=3.0, turn=0.5, seconds=7.0),
    "fifteen percent uphill": lambda: drive(grade=0.15),
    "fifteen percent downhill": lambda: drive(grade=-0.15, turn=-0.1),
    "a motorway": lambda: drive(speed=38.0, turn=0.01),
    "half a second": lambda: drive(seconds=0.5),
    "two poses": lambda: drive(seconds=0.1),
    "a pedestrian who turns around": lambda: _of_one("walk", _half_turns)(drive()),
    "key frames of two a second": lambda: _times(5)(drive(speed=40.0, turn=0.2)),
    "no sensors": lambda: replace(drive(), cameras={}, lidars={}),
    "no tracks": lambda: replace(drive(), tracks={}),
}
"""Unusual drives that are as they should be."""
