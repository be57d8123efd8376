"""The true look of a synthetic world from anywhere, and a drive of the rig through it, as a log.

Every measurement has random numbers of its own, by seed, sensor and frame, so that it does not
matter in which order and by whom they are made.
"""

from __future__ import annotations

import multiprocessing
import pickle
import shutil
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from recast.arrays import Array
from recast.cameras import PinholeCamera
from recast.core import files
from recast.core.diagnostics import Progress
from recast.core.errors import InputError, require_range
from recast.core.workers import WAITING, Closing, begin_worker, submit, usable_cores
from recast.geometry import se3
from recast.logs import (
    CameraStream,
    DrivingLog,
    LidarStream,
    LidarSweep,
    Track,
    Trajectory,
    write_log,
)
from recast.logs.images import ImageFiles
from recast.synthetic.populate import world_metadata
from recast.synthetic.rendering import (
    WAYMO_TOP,
    CameraFrame,
    RayScene,
    render_camera,
    require_embree,
    scan_lidar,
    working_llvm,
)
from recast.synthetic.world import (
    LIDAR,
    TRUTH_FOLDER,
    Quality,
    Rig,
    RigCamera,
    TruthRecord,
    World,
    make_rig,
    sensor_number,
    write_truth_frame,
    write_truth_record,
)

_STREAM = 601
Job = TypeVar("Job")
Result = TypeVar("Result")


class Oracle:
    """Renders a world by ray tracing.

    Parked vehicles are part of the street: they are always drawn, where they stand unless `poses`
    says otherwise. Moving ones are drawn only where `poses` has them. People walk and pedal by the
    way that they have gone, so that their poses tell their shapes.

    Args:
        world: any `World`; see `world_of` for that of a log.

    Raises:
        InputError: embreex is not installed.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self.scene = RayScene(
            world.street.surface, {key: v.model.surface for key, v in world.vehicles.items()}
        )
        self._parked = {k: v.trajectory.poses[0] for k, v in world.vehicles.items() if v.parked}

    def render(
        self,
        camera: PinholeCamera,
        world_from_camera: Array,
        poses: Mapping[str, Array] | None = None,
        timestamp_us: int | None = None,
        exposure: float = 1.0,
        rng: np.random.Generator | None = None,
        *,
        absent: Collection[str] = (),
        hidden: Collection[str] = (),
        alone: Collection[str] | None = None,
    ) -> CameraFrame:
        """What a camera sees.

        Args:
            world_from_camera: (4, 4), OpenCV camera frame.
            poses: `world_from_actor` (4, 4) by track id; None for those of the log.
            timestamp_us: time in the log in microseconds, needed where `poses` is None.
            exposure: factor on all light.
            rng: random generator of the rays; None for one that only the world's seed decides.
            absent: tracks that are taken out of the world, parked ones too.
            hidden: tracks that the camera looks through; their shadows and reflections stay.
            alone: tracks beside which nothing is seen, in the light that they have in the street;
                None to see everything.

        Raises:
            InputError: `poses` names a vehicle that the world lacks.
            ValueError: neither poses nor a time are given, or a time outside the log.
        """
        if rng is None:
            rng = np.random.default_rng([self.world.seed, _STREAM])
        if poses is None:
            if timestamp_us is None:
                raise ValueError("Oracle.render: give poses or a timestamp_us")
            poses = self.logged_poses(timestamp_us)
        drawn = {key: pose for key, pose in self.drawn(poses).items() if key not in absent}
        if alone is not None:
            hidden = {*hidden, *(key for key in drawn if key not in alone)}
        return render_camera(
            self.scene_at(drawn),
            self.world.street.sky,
            camera,
            world_from_camera,
            drawn,
            rng=rng,
            exposure=exposure,
            quality=self.world.light,
            hidden=hidden,
            street=alone is None,
        )

    def drawn(self, poses: Mapping[str, Array]) -> dict[str, Array]:
        """Poses of all that is drawn: `poses`, and the parked vehicles it does not name. Raises
        InputError: `poses` names a vehicle that the world lacks."""
        for track_id in poses:
            if track_id not in self.world.vehicles:
                mend = f"choose one of {', '.join(self.world.vehicles)}"
                problem = "is not in the synthetic world"
                raise InputError(self.world.name, f"track {track_id}", problem, mend)
        return {**self._parked, **poses}

    def scene_at(self, poses: Mapping[str, Array]) -> RayScene:
        """The scene in which people have the shapes of their poses, see `Vehicle.surface_at`."""
        shapes = {
            key: self.world.vehicles[key].surface_at(pose)
            for key, pose in poses.items()
            if self.world.vehicles[key].model.articulation is not None
        }
        return self.scene.with_models(shapes) if shapes else self.scene

    def logged_poses(self, timestamp_us: int) -> dict[str, Array]:
        """Poses of all vehicles at a time of the log; ValueError outside it."""
        vehicles = self.world.vehicles
        return {key: vehicle.trajectory.at(timestamp_us) for key, vehicle in vehicles.items()}

    def instance_of(self, track_id: str) -> int:
        """The value of a vehicle's pixels in `CameraFrame.instance`; KeyError for no such one."""
        return instances(self.world)[track_id]


def instances(world: World) -> dict[str, int]:
    """Instance values by track id: 1, 2, ... in the order of sorted ids; 0 is the street."""
    return {track_id: number for number, track_id in enumerate(sorted(world.vehicles), 1)}


_oracle: Oracle | None = None


class OraclePool(Closing):
    """Calls functions with an oracle, several at a time; what they return does not depend on that.

    Use it as a context manager, or close it.

    Args:
        world: what the oracles show.
        workers: processes; 0 for one for each core, 1 for none but this one.
        most: jobs that there ever are at a time; more processes are never started.

    Raises:
        InputError: workers is negative, or embreex is not installed.
    """

    def __init__(self, world: World, workers: int = 0, most: int | None = None) -> None:
        require_embree()
        if workers < 0:
            raise InputError("workers", str(workers), "is negative", "choose 0 for all cores")
        wanted = workers or usable_cores()
        self.workers = wanted if most is None else max(1, min(wanted, most))
        self._world = world
        self._own: Oracle | None = None
        self._executor: ProcessPoolExecutor | None = None
        self._spool: TemporaryDirectory[str] | None = None

    def map(
        self, function: Callable[[Oracle, Job], Result], jobs: Iterable[Job]
    ) -> Iterator[Result]:
        """`function(oracle, job)` of every job, in their order.

        Args:
            function: function of a module, so that other processes find it.

        Raises:
            InputError: a process was killed.
            Exception: whatever `function` raises.
        """
        if self.workers == 1:
            for job in jobs:
                yield function(self.oracle, job)
            return
        left = iter(jobs)
        waiting: deque[Future[Result]] = deque()
        try:
            executor = self._started()
            for job in islice(left, WAITING * self.workers):
                waiting.append(submit(executor, _call, function, job))
            while waiting:
                result = waiting.popleft().result()
                for job in islice(left, 1):
                    waiting.append(submit(executor, _call, function, job))
                yield result
        except BrokenProcessPool:
            raise InputError(
                "workers",
                str(self.workers),
                "a rendering process was killed, or ended at its start",
                "use fewer workers if memory is short; guard a script's start by __name__",
            ) from None
        finally:
            for future in waiting:
                future.cancel()

    @property
    def oracle(self) -> Oracle:
        """An oracle in this process."""
        if self._own is None:
            self._own = Oracle(self._world)
        return self._own

    def close(self) -> None:
        """End the processes."""
        if self._executor is not None:
            self._executor.shutdown(wait=True, cancel_futures=True)
            self._executor = None
        if self._spool is not None:
            self._spool.cleanup()
            self._spool = None

    def _started(self) -> ProcessPoolExecutor:
        if self._executor is None:
            # Not by initargs: their bytes go through a pipe that blocks for ever where a process
            # dies at its start, as it does in a script whose start is not guarded.
            self._spool = TemporaryDirectory(prefix="recast-world-")
            path = Path(self._spool.name) / "world"
            path.write_bytes(pickle.dumps(self._world))
            self._executor = ProcessPoolExecutor(
                self.workers,
                mp_context=multiprocessing.get_context("spawn"),
                initializer=_start,
                initargs=(path,),
            )
        return self._executor


def _start(path: Path) -> None:
    global _oracle
    begin_worker()
    _oracle = Oracle(pickle.loads(path.read_bytes()))  # written by the parent just now


def _call(function: Callable[[Oracle, Job], Result], job: Job) -> Result:
    assert _oracle is not None  # set by _start
    return function(_oracle, job)


_CAMERA_STREAM, _LIDAR_STREAM = 201, 202
_LABEL_STREAM = 401
_HEIGHT_SHARE = 0.3
"""Share of the noise that is left in height: the ground tells an annotator where a box stands."""
_LEAST_SIZE = 0.5


@dataclass(frozen=True)
class Measurement:
    """One image or sweep to be made."""

    sensor: str  # a camera's name, or `LIDAR`
    frame: int  # index of the moment in the log
    timestamp_us: int  # time of that moment in microseconds
    rig: Rig  # the sensors
    spool: Path  # folder for images and sweeps, with a folder for each sensor
    truth: Path | None = None  # folder for depth and instances, or None


def measure(oracle: Oracle, job: Measurement) -> tuple[int, ...]:
    """Make one measurement and write its files; returns the instances seen."""
    if job.sensor == LIDAR:
        return _scan(oracle, job)
    return _photograph(oracle, job, job.rig.cameras[job.sensor])


def _photograph(oracle: Oracle, job: Measurement, camera: RigCamera) -> tuple[int, ...]:
    world = oracle.world
    frame = oracle.render(
        camera.camera,
        world.ego.at(job.timestamp_us) @ camera.rig_from_camera,
        timestamp_us=job.timestamp_us,
        exposure=world.exposure(job.sensor, job.timestamp_us),
        rng=_generator(oracle, _CAMERA_STREAM, job),
    )
    PillowImage.fromarray(frame.rgb).save(image_file(job.spool, job.sensor, job.frame))
    if job.truth is not None:
        write_truth_frame(job.truth, job.sensor, job.frame, frame.depth, frame.instance)
    return tuple(np.unique(frame.instance).tolist())


def _scan(oracle: Oracle, job: Measurement) -> tuple[int, ...]:
    world_from_lidar = oracle.world.ego.at(job.timestamp_us) @ job.rig.rig_from_lidar
    poses = oracle.logged_poses(job.timestamp_us)
    rng = _generator(oracle, _LIDAR_STREAM, job)
    drawn = oracle.drawn(poses)
    scan = scan_lidar(oracle.scene_at(drawn), WAYMO_TOP, world_from_lidar, drawn, rng)
    points = se3.apply(job.rig.rig_from_lidar, scan.points).astype(np.float32)
    path = _sweep_file(job.spool, job.frame)
    np.savez(path, points=points, intensity=scan.intensity.astype(np.float32))
    return tuple(np.unique(scan.instance).tolist())


def _generator(oracle: Oracle, stream: int, job: Measurement) -> np.random.Generator:
    return np.random.default_rng([oracle.world.seed, stream, sensor_number(job.sensor), job.frame])


def image_file(spool: Path, camera: str, frame: int) -> Path:
    """Where an image lies."""
    return spool / camera / f"{frame:04d}.png"


def _sweep_file(spool: Path, frame: int) -> Path:
    return spool / LIDAR / f"{frame:04d}.npz"


@dataclass(frozen=True)
class SpooledSweeps:
    """All sweeps; see `recast.logs.types.SweepSource`."""

    spool: Path
    timestamps_us: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.timestamps_us)

    def __getitem__(self, index: int) -> LidarSweep:
        with np.load(_sweep_file(self.spool, index), allow_pickle=False) as archive:
            points, intensity = archive["points"], archive["intensity"]
        return LidarSweep(int(self.timestamps_us[index]), points, intensity)


def check_label_noise(metres: float) -> None:
    """Refuse impossible noise. Raises InputError: negative, or not a number."""
    if not 0 <= metres < np.inf:
        raise InputError("label noise", f"{metres:g} m", "is impossible", "choose 0 or more metres")


def with_label_noise(tracks: Mapping[str, Track], metres: float, seed: int) -> dict[str, Track]:
    """Tracks with independent normal errors in every label, and one error of size a track.

    Args:
        metres: standard deviation of each coordinate on the ground, and of length and width; the
            yaw's moves the ends of the box by as much.
    """
    check_label_noise(metres)
    if metres == 0:
        return dict(tracks)
    return {key: _noisy(track, metres, seed) for key, track in tracks.items()}


def _noisy(track: Track, metres: float, seed: int) -> Track:
    rng = np.random.default_rng([seed, _LABEL_STREAM, sensor_number(track.track_id)])
    scale = np.array([1.0, 1.0, _HEIGHT_SHARE]) * metres
    size = np.maximum(track.size + scale * rng.normal(size=3), _LEAST_SIZE * track.size)
    poses = track.trajectory.poses.copy()
    poses[:, :3, 3] += scale * rng.normal(size=(len(poses), 3))
    yaw = metres / (track.size[0] / 2) * rng.normal(size=len(poses))
    poses[:, :3, :3] = poses[:, :3, :3] @ se3.rotation_z(yaw)
    trajectory = Trajectory(track.trajectory.timestamps_us, poses)
    return Track(track.track_id, track.category, size, trajectory)


def synthesize_log(
    world: World,
    out: str | Path,
    *,
    width: int = 480,
    height: int = 320,
    cameras: tuple[str, ...] | None = None,
    workers: int = 0,
    truth: bool = False,
    label_noise: float = 0.0,
    every: int = 1,
    progress: Progress | None = None,
) -> None:
    """Write what the rig sees of `world` to the new log folder `out`.

    Ten times a second, up to but not at the last pose of the ego, all cameras and the LiDAR measure
    at the same instant: no rolling shutter, and sweeps are instantaneous. Labelled is every vehicle
    that any sensor ever saw, at all poses. The folder appears whole or not at all, and holds the
    same bytes for the same world whatever the number of workers.

    Args:
        width, height: size of the images, pixels.
        cameras: names out of `CAMERAS`, None for all.
        workers: processes; 0 for one for each core.
        truth: also write exact depth and instance masks, see `recast.synthetic.world`.
        label_noise: metres, standard deviation of the boxes, see `with_label_noise`.
        every: measure at every n-th of these moments only; labels stay at ten a second.

    Raises:
        InputError: an impossible size or n, an unknown camera, negative noise or workers; `out`
            exists; embreex is missing; the disk is full.
    """
    check_request(out, width, height, label_noise, cameras, world.light)
    require_range(1, every=every)
    rig = make_rig(width, height, cameras)
    with OraclePool(world, workers) as pool, files.atomic_folder(out) as folder:
        spool, truth_folder = folder / "spool", folder / TRUTH_FOLDER if truth else None
        for sensor in (*rig.cameras, LIDAR):
            (spool / sensor).mkdir(parents=True)
        times = moments(world)[::every]
        jobs = list(_measurements(times, rig, spool, truth_folder))
        seen: set[int] = set()
        for done, met in enumerate(pool.map(measure, jobs), 1):
            seen.update(met)
            if progress is not None:
                progress(done, len(jobs))
        pool.close()
        log = _log(world, rig, spool, times, _tracks(world, seen, label_noise))
        write_log(log, folder / "log")
        shutil.rmtree(spool)
        for entry in sorted((folder / "log").iterdir()):
            entry.replace(folder / entry.name)
        (folder / "log").rmdir()
        if truth_folder is not None:
            frames = dict.fromkeys(rig.cameras, len(times))
            names = {number: track_id for track_id, number in instances(world).items()}
            write_truth_record(truth_folder, TruthRecord(frames=frames, instances=names))


def check_request(
    out: str | Path,
    width: int,
    height: int,
    label_noise: float,
    cameras: tuple[str, ...] | None = None,
    light: Quality = "standard",
) -> None:
    """Refuse what `synthesize_log` would refuse, before a world is made for it.

    Raises:
        InputError: an impossible size, an unknown camera, negative noise, `out` exists, or embreex
            or what `light` needs is not installed.
    """
    require_embree()
    if light == "mitsuba":
        working_llvm()
    make_rig(width, height, cameras)
    check_label_noise(label_noise)
    files.require_new(out)


def moments(world: World) -> NDArray[np.int64]:
    """Times (F,) of images and sweeps, microseconds: those of all poses but the last."""
    return world.ego.timestamps_us[:-1]


def _measurements(
    times: NDArray[np.int64], rig: Rig, spool: Path, truth: Path | None
) -> Iterator[Measurement]:
    for frame, timestamp in enumerate(times.tolist()):
        for sensor in (*rig.cameras, LIDAR):
            yield Measurement(sensor, frame, timestamp, rig, spool, truth)


def _tracks(world: World, seen: set[int], label_noise: float) -> dict[str, Track]:
    labelled = {key for key, number in instances(world).items() if number in seen}
    tracks = {
        key: Track(key, vehicle.model.category, vehicle.model.size, vehicle.trajectory)
        for key, vehicle in world.vehicles.items()
        if key in labelled
    }
    return with_label_noise(tracks, label_noise, world.seed)


def _log(
    world: World, rig: Rig, spool: Path, times: NDArray[np.int64], tracks: dict[str, Track]
) -> DrivingLog:
    cameras = {
        name: CameraStream(
            name=name,
            camera=mounted.camera,
            rig_from_camera=mounted.rig_from_camera,
            timestamps_us=times,
            images=ImageFiles(
                tuple(image_file(spool, name, frame) for frame in range(len(times))),
                mounted.camera.width,
                mounted.camera.height,
                "the rig",
            ),
        )
        for name, mounted in rig.cameras.items()
    }
    lidar = LidarStream(LIDAR, rig.rig_from_lidar, times, SpooledSweeps(spool, times))
    return DrivingLog(
        name=f"{world.name}-{world.seed}",
        cameras=cameras,
        lidars={LIDAR: lidar},
        world_from_rig=world.ego,
        tracks=tracks,
        map=world.street.map,
        metadata=world_metadata(world),
    )
