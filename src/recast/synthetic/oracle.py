"""The true look of a synthetic world from anywhere, alone or in several processes."""

from __future__ import annotations

import multiprocessing
import pickle
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import numpy as np

from recast.arrays import Array
from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.workers import WAITING, Closing, begin_worker, submit, usable_cores
from recast.synthetic.rendering import CameraFrame, RayScene, render_camera, require_embree
from recast.synthetic.world import World

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
