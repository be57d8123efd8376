"""One scene of a grid: its log, its pieces of work, their artefacts, and its rows at the end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

from rich.console import Console

from recast.core import Artefact, Store, folder_hash
from recast.metrics.table import script_difference
from recast.runs.arms import Arm
from recast.runs.artefacts import Artefacts
from recast.runs.config import RunConfig
from recast.runs.making import Maker, copy_folder, drive_world
from recast.runs.rollouts import read_rollout
from recast.runs.run_folder import LOG_FOLDER, rollout_name
from recast.runs.sources import SourceLog, Sources
from recast.simulation import Rollout
from recast.studies.grid import BenchScene, BenchSettings, GridRow
from recast.synthetic import make_world

OTHER_SCRIPT = "OtherScript"
"""Error of a row whose actor, route or start is not that of the other arms."""


def log_artefact(store: Store, scene: BenchScene, settings: BenchSettings) -> Artefact:
    """The log of a synthetic scene; or a copy of a recorded one, to travel to other machines.

    InputError: see `make_world` and `drive_log`.
    """
    if scene.log is not None:
        path = scene.log
        return store.make(
            "logs",
            {"content": folder_hash(path)},
            lambda out: copy_folder(path, out / LOG_FOLDER),
            name=scene.id,
        )
    assert scene.world is not None and scene.seed is not None
    size, cameras = settings.drive, settings.run.scene.cameras
    world = make_world(scene.world, scene.seed, size.seconds)
    maker = Maker(store, Console(quiet=True))
    return drive_world(maker, world, (size.width, size.height), cameras, scene.id)


def open_scene(
    scene: BenchScene, settings: BenchSettings, log: Artefact | None
) -> tuple[SourceLog, RunConfig]:
    """The log of a scene, and what is run on it."""
    path = scene.log if log is None else log.path / LOG_FOLDER
    assert path is not None  # synthetic logs are artefacts
    source = SourceLog.open(path)
    track = source.log.metadata["target"] if scene.track is None else scene.track
    return source, settings.run_of(track)


class SceneRun:
    """The artefacts of a scene; close it.

    Args:
        log: the artefact of its log; None for one in a folder of its own.

    Raises:
        InputError: a faulty log, or a camera that a planner wants and the log lacks.
    """

    def __init__(
        self,
        store: Store,
        scene: BenchScene,
        settings: BenchSettings,
        log: Artefact | None,
        known: Sources | None = None,
    ) -> None:
        self.log = log
        source, config = open_scene(scene, settings, log)
        sources = Sources.of(config, scene.id, known)
        console = Console(quiet=True)
        self.artefacts = Artefacts(store, source, config, sources, console, scene.id, 1)
        self.artefacts.require_makeable()
        if log is not None:
            self.artefacts.used["log"] = log

    def prepare(self) -> None:
        """Make streets and vehicles, as far as anything is rendered.

        A planner that reads states, without films, needs none of them.
        """
        for planner in self.artefacts.config.planners:
            self.artefacts.mounts(planner)
        for arm in self.artefacts.arms.values():
            self.artefacts.prepare(arm, further=False)

    @property
    def path(self) -> Path:
        """The folder of the log."""
        return self.artefacts.source.path

    def used(self) -> dict[str, str]:
        """References by use."""
        return {use: one.reference for use, one in self.artefacts.used.items()}


@dataclass(frozen=True)
class GridTask:
    """A piece of work on a scene.

    Attributes:
        log: reference of its log in the store; None while there is none, or where it lies in a
            folder of its own.
        tickets: tickets of the artefacts that it needs, where workers share no folder with this
            process.
    """

    scene: BenchScene
    log: str | None = None
    tickets: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class SceneTask(GridTask):
    """From nothing to log, streets and vehicles, as far as the rollouts need them."""


@dataclass(frozen=True)
class RolloutTask(GridTask):
    """One rollout of a scene that is there."""

    motion: str = ""
    planner: str = ""
    arm: str = ""

    @property
    def use(self) -> str:
        """What the run of the scene calls the rollout."""
        return rollout_name(self.motion, self.planner, self.arm)


@dataclass(frozen=True)
class RolloutTimes:
    """Wall-clock seconds of a rollout that was made now.

    Attributes:
        render, plan, control: see `recast.simulation.Timings`.
        total: seconds of everything, loading and writing included.
        frames: number of frames rendered.
    """

    render: float
    plan: float
    control: float
    total: float
    frames: int


@dataclass(frozen=True)
class SceneOutcome:
    """What came of a task.

    Attributes:
        used: references of the artefacts by use, see `Artefacts.used`.
        log: reference of the log in the store, if it lies there.
        error, reason, traceback: error that the task raised, its reason and its traceback; None if
            the task is done.
        times: durations of a rollout that was made now; None for all else.
        parcels: artefacts that were made, by reference, where no folder is shared.
    """

    used: Mapping[str, str] = field(default_factory=dict)
    log: str | None = None
    error: str | None = None
    reason: str | None = None
    traceback: str | None = None
    times: RolloutTimes | None = None
    parcels: Mapping[str, bytes] = field(default_factory=dict)


def blank_row(scene: BenchScene, config: RunConfig, motion: str, planner: str, arm: str) -> GridRow:
    """The row of a rollout of which nothing is known yet.

    Args:
        planner: its name in results.
    """
    found = config.motion(motion)
    return GridRow(
        scene=scene.id,
        world=scene.world,
        seed=scene.seed,
        motion=found.name,
        setting=found.setting,
        arm=arm,
        planner=planner,
    )


def scene_rows(
    scene: BenchScene,
    config: RunConfig,
    log: str,
    names: Mapping[str, str],
    metrics: Mapping[str, Any],
    used: Mapping[str, Artefact],
    errors: Mapping[str, SceneOutcome],
) -> list[GridRow]:
    """The rows of a scene, by motion, then by planner, then by arm.

    Every arm must have been given the same route and start (beside it, if its noise says so), and
    the same states of actors that do not react to the ego: a row that was not is a failure.

    Args:
        names: planners' names in results, by the word that asks for them.
        errors: errors of rollouts that could not begin, by use.
    """
    scored = {_key(one): one for one in metrics["rollouts"]}
    failures = {_key(one): one for one in metrics["failures"]}
    rows = []
    for motion in config.motions:
        first = _first(motion, config, used)
        for planner in config.planners:
            for arm in config.arms:
                row = blank_row(scene, config, motion, names[planner], arm.name)
                row = row.of_log(log, config.track)
                key = (row.motion, row.setting, row.planner, row.arm)
                use = rollout_name(motion, planner, arm.name)
                if use in errors:
                    error = errors[use]
                    rows.append(row.failed(error.error or "Error", error.reason or ""))
                    continue
                if key in failures:
                    rows.append(row.failed(failures[key]["error"], failures[key]["reason"]))
                    continue
                rollout = read_rollout(used[use].path)
                assert isinstance(rollout, Rollout) and first is not None  # else a failure
                left = arm.start_left - first[0].start_left
                differs = script_difference(first[1], rollout, left)
                if differs is None:
                    rows.append(row.scored(scored[key]))
                else:
                    told = f"{differs}, compared with {first[1].name}"
                    rows.append(row.failed(OTHER_SCRIPT, told))
    return rows


def _first(
    motion: str, config: RunConfig, used: Mapping[str, Artefact]
) -> tuple[Arm, Rollout] | None:
    """The rollout with which all others of a motion are compared, and its arm.

    Arms that start where the log does go first. None where no rollout was made.
    """
    arms = sorted(config.arms, key=lambda arm: arm.start_left != 0)
    for arm, planner in product(arms, config.planners):
        made = used.get(rollout_name(motion, planner, arm.name))
        rollout = None if made is None else read_rollout(made.path)
        if isinstance(rollout, Rollout):
            return arm, rollout
    return None


def _key(entry: Mapping[str, Any]) -> tuple[str, str, str, str]:
    return entry["motion"], entry["setting"], entry["planner"], entry["arm"]
