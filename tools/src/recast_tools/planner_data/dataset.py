"""`recast planner dataset`: worlds of samples, made by several processes; resumes and grows."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast.arrays import Image
from recast.core import Store, open_store
from recast.core.diagnostics import Progress
from recast.core.errors import InputError, require_range
from recast.core.files import alone_in, write_json
from recast.core.records import read_record
from recast.core.workers import worker_pool
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.planning.gtrs import MotionPrimitives, ViewLayout, load_gtrs
from recast.planning.gtrs.expert import TrajectoryTargets, score_trajectories
from recast.planning.gtrs.perception import ROAD_AT
from recast.planning.types import ego_status
from recast.runs.run_folder import STORE_FOLDER
from recast.synthetic import make_world
from recast.synthetic.world import RigCamera, make_rig
from recast.synthetic.write import Oracle
from recast_tools.planner_data.drive import SampleSituation, begin_drive
from recast_tools.planner_data.reconstruction import (
    SamplePainter,
    reconstruct,
    traced,
)
from recast_tools.planner_data.stage import SampleStage, make_stage
from recast_tools.planner_training.samples import (
    CLUES,
    DRIVER_FOLDER,
    EVERY,
    MEND,
    RECORD_FILE,
    VERSION,
    DatasetRecord,
    Renderer,
    Sample,
    world_folder,
    write_world,
)
from recast_tools.planner_training.targets import column_values
from recast_tools.planner_training.task import COLUMN_LOOKS, HALF_VIEWS

_SEEN = np.deg2rad(68.0)
FIRST_SEED = 1000
"""First seed of training worlds; those below are for evaluation."""
_WORLDS_PER_SEED = 100_000
_TWINS = 0.25
"""Share of the drives with an actor whose samples are made once more without it."""
_MOST_DRIVES = 20
"""Drives for each sample of a world, after which it has no room for them."""
_PLANNER_DRIVES = 0.5
_MISTAKEN = 0.25
"""Share of the expert's moments in which it drives any trajectory."""


def make_dataset(
    out: Path,
    count: int,
    record: DatasetRecord,
    *,
    driver: Path | None = None,
    store: str | Path | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> int:
    """Make at least `count` samples; worlds that are there already are kept.

    The files are the same for any number of workers and of interruptions.

    Args:
        driver: folder of a GTRS planner that drives every second drive, whose hash the record has;
            it is copied to `out`. The expert drives all if None.
        store: folder or address of the logs, streets and vehicles of reconstructed worlds; `store/`
            beside `out` if None.

    Returns:
        How many samples there are: whole worlds.

    Raises:
        InputError: `out` holds samples of other settings, embreex is missing, a count or number of
            workers is below one, or another process is at work there.
    """
    from recast.synthetic.rendering import require_embree

    require_range(1, samples=count, workers=workers)
    require_embree()
    _open(out, record, driver)
    worlds = -(-count // record.per_world)
    left = [i for i in range(worlds) if not world_folder(out, i).exists()]
    done, numbers = worlds - len(left), iter(left)

    def report() -> None:
        if progress is not None:
            progress(done * record.per_world, worlds * record.per_world)

    report()
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # of the processes, whose numpy loads later
    pool = worker_pool(min(workers, len(left)) or 1)
    place = str(out.absolute().parent / STORE_FOLDER if store is None else store)
    with alone_in(out):
        for _ in pool(_start, (out, record, place), lambda: next(numbers, None), "finished worlds"):
            done += 1
            report()
    return worlds * record.per_world


def _start(worker: int, out: Path, record: DatasetRecord, store: str) -> Callable[[int], None]:
    del worker  # makes no difference
    driver = Driver(out / DRIVER_FOLDER if record.driver else None)
    return partial(make_world_samples, out, record=record, driver=driver, store=open_store(store))


def make_world_samples(
    out: Path, number: int, record: DatasetRecord, driver: Driver, store: Store
) -> None:
    """Make the samples of one world; they depend on the record, the driver and the number.

    A world whose log shows too little of its target is rendered by the oracle, too.
    """
    scene = record.scene_of(number)
    seed = FIRST_SEED + _WORLDS_PER_SEED * record.seed + number
    shown = None
    if record.is_reconstructed(number):
        shown = reconstruct(make_world(scene, seed, record.seconds), store, record.street_steps)
    stage = make_stage(scene, seed, record.seconds) if shown is None else shown.stage
    oracle = Oracle(stage.world)
    shows: tuple[Renderer, ...] = record.renderers if shown is not None else ("oracle",)
    written = SampleWriter(record.per_world)
    drives = 0
    while not written.full:
        rng = np.random.default_rng([seed, record.seed, drives])
        renderer = shows[(number + drives) % len(shows)]
        # Noise of its own: a drive is the same whoever shows it.
        noise = np.random.default_rng(rng.integers(2**63))
        paint = traced(oracle, noise)
        if shown is not None and renderer != "oracle":
            paint = shown.painter(renderer)
        drive = begin_drive(stage, record.kinds, rng)
        drives += 1
        if drives > _MOST_DRIVES * record.per_world:
            raise InputError(
                stage.world.name,
                f"seed {stage.world.seed}",
                "has no room for the ego",
                "use another `seed`; please report this, it should not happen",
            )
        driver.begin(rng)
        with_twins, before, twin_before = bool(rng.uniform() < _TWINS), -1, -1
        seen: list[Image] = []
        while drive is not None and not written.full:
            situation = drive.situation(record.speeds, rng)
            if situation is None:
                break
            image = render(paint, stage, situation)
            sample, possible, targets = describe(
                stage, situation, image, renderer, record.primitives
            )
            seen.append(image)
            before = written.add(sample, before)
            if with_twins and situation.actor is not None and not written.full:
                alone, in_sight = situation.without_actor(), sample.clues[0] > 0
                image = render(paint, stage, alone) if in_sight else image
                twin = describe(stage, alone, image, renderer, record.primitives)[0]
                twin_before = written.add(twin, twin_before, before if in_sight else -1)
            if targets.total.max() <= 0.0:  # nothing helps any more; the best brakes hardest
                break
            drive.go(driver.choose(sample, seen, possible, targets, rng).astype(np.float64))
    folder = world_folder(out, number)
    write_world(folder, written.samples, written.twins, written.before, record.primitives)


class SampleWriter:
    """The samples of a world, and which belong together.

    Attributes:
        twins: for each the index of the one that differs in the vehicle alone, or -1.
        before: for each the index of the one before it in the drive, or -1.
    """

    def __init__(self, room: int) -> None:
        self.samples: list[Sample] = []
        self.twins: list[int] = []
        self.before: list[int] = []
        self._room = room

    @property
    def full(self) -> bool:
        """Whether there is room for no other sample."""
        return len(self.samples) >= self._room

    def add(self, sample: Sample, before: int, twin: int = -1) -> int:
        """Add a sample, and give its index."""
        index = len(self.samples)
        self.samples.append(sample)
        self.before.append(before)
        self.twins.append(twin)
        if twin >= 0:
            self.twins[twin] = index
        return index


class Driver:
    """Who drives a drive on: an expert that knows the scores, or a planner that sees the image.

    The expert takes the best trajectory, and in `_MISTAKEN` of the moments any other that keeps to
    the lane: so samples come from beside the best states, too. With a planner, it drives every
    second drive.

    Args:
        planner: folder of a GTRS planner; None for the expert alone.
    """

    def __init__(self, planner: Path | None) -> None:
        self._planner = None if planner is None else load_gtrs(planner)
        self._sees = False

    def begin(self, rng: np.random.Generator) -> None:
        """Choose who drives the next drive."""
        self._sees = self._planner is not None and bool(rng.uniform() < _PLANNER_DRIVES)

    def choose(
        self,
        sample: Sample,
        seen: Sequence[Image],
        possible: NDArray[np.float32],
        targets: TrajectoryTargets,
        rng: np.random.Generator,
    ) -> NDArray[np.float32]:
        """The trajectory (40, 3) to be followed from a sample, at its first speed.

        Args:
            seen: the images of the drive, the present one last.
            possible: (L, 40, 3) what the expert chooses from.
            targets: their scores.
        """
        if self._sees:
            assert self._planner is not None
            found = self._planner.judge(seen, sample.status[0], EVERY)
            return found.driven(self._planner.weights.blended).astype(np.float32)
        if rng.uniform() < _MISTAKEN:
            in_lane = np.flatnonzero((targets.scores[[1, 4, 5]] > 0).all(axis=0))
            if len(in_lane):
                return possible[int(rng.choice(in_lane))]
        return possible[targets.best]


def _open(out: Path, record: DatasetRecord, driver: Path | None) -> None:
    path = out / RECORD_FILE
    if path.exists():
        if read_record(path, DatasetRecord, VERSION, MEND, record.format) != record:
            raise InputError(path, "settings", "differ from those of this command", MEND)
        return
    # A kill may have left the driver without the record.
    if out.exists() and any(entry.name != DRIVER_FOLDER for entry in out.iterdir()):
        raise InputError(out, "output folder", "contains other files", "choose another folder")
    if driver is not None:
        shutil.copytree(driver, out / DRIVER_FOLDER, dirs_exist_ok=True)
    write_json(path, record.model_dump(mode="json"))  # last: where it is, the driver is


def render(paint: SamplePainter, stage: SampleStage, situation: SampleSituation) -> Image:
    """(128, 512, 3) uint8: the three views cropped and stitched; only what is kept is rendered."""
    poses = (
        {}
        if situation.actor is None
        else {situation.actor.obstacle.token: situation.actor.world_from_actor}
    )
    for other in situation.others:
        vehicle = stage.world.vehicles[other.token]
        poses[other.token] = stage.surface.actor_poses(other.poses[:1], vehicle.model.size)[0]
    world_from_rig = stage.surface.ego_poses(situation.states[0, ego.POSE])
    parts = [
        paint(name, mounted.camera, world_from_rig @ mounted.rig_from_camera, poses)
        for name, mounted in _kept(HALF_VIEWS).items()
    ]
    return np.concatenate(parts, axis=1)


@cache
def _kept(layout: ViewLayout) -> dict[str, RigCamera]:
    """The rig's cameras, cut to what a layout keeps of them."""
    rig = make_rig(layout.width, layout.height, layout.cameras)
    found = {}
    for name in layout.cameras:
        margin = 0 if name == layout.cameras[1] else layout.crop_columns
        size = layout.width - 2 * margin, layout.height - 2 * layout.crop_rows
        camera = rig.cameras[name].camera.cropped(margin, layout.crop_rows, *size)
        found[name] = replace(rig.cameras[name], camera=camera)
    return found


def describe(
    stage: SampleStage,
    situation: SampleSituation,
    image: Image,
    renderer: Renderer,
    primitives: MotionPrimitives,
) -> tuple[Sample, NDArray[np.float32], TrajectoryTargets]:
    """The sample of a situation and its picture; the trajectories (L, 40, 3) at its first speed,
    and their scores."""
    status = np.stack([ego_status(situation.command, state) for state in situation.states])
    possible = primitives.trajectories(status)
    targets = [
        score_trajectories(each, state, stage.road, situation.obstacles)
        for each, state in zip(possible, situation.states, strict=True)
    ]
    sample = Sample(
        image=image,
        status=status,
        scores=np.stack([found.scores for found in targets]),
        best=np.array([found.best for found in targets], np.int32),
        clues=_clues(stage, situation),
        columns=column_values(situation.states[0], situation.obstacles, COLUMN_LOOKS),
        renderer=renderer,
    )
    return sample, possible[0], targets[0]


def _clues(stage: SampleStage, situation: SampleSituation) -> NDArray[np.float32]:
    """What the picture tells, see `CLUES`."""
    pose = situation.states[0, ego.POSE]
    clues = np.zeros(len(CLUES), np.float32)
    if situation.actor is not None:
        x, y, heading = se2.relative(pose, situation.actor.obstacle.poses[0])
        if x > 0 and abs(np.arctan2(y, x)) < _SEEN:
            clues[:5] = 1.0, x, y, np.cos(heading), np.sin(heading)
    s, lateral = stage.route.project(pose)
    turn = se2.wrap_angle(pose[2] - stage.route.heading(s))
    ahead = se2.relative(pose, stage.route.pose(s + np.array(ROAD_AT)))[:, 1]
    clues[5:] = lateral, turn, *ahead
    return clues
