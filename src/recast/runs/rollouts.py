"""One rollout as a finished folder, with a film of every camera."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from recast.core import files
from recast.core.errors import InputError, UnreachableError
from recast.core.names import folder_name, member
from recast.core.records import Record, read_record, validation_error
from recast.logs import DrivingLog, HdMap
from recast.planning import (
    Planner,
    ShownView,
    planner_cameras,
    seen_record,
)
from recast.reporting.video import VideoWriter, write_video
from recast.runs.config import RunConfig
from recast.simulation import (
    Rollout,
    RolloutFailure,
    RolloutSetup,
    ScriptedMotion,
    SensorRenderer,
    SimState,
    Timings,
    failure,
    load_rollout,
    run_rollout,
    save_rollout,
)
from recast.simulation.coverage import Meter, RolloutCoverage, rollout_coverage
from recast.simulation.history import other_poses
from recast.simulation.renderer import RestoringRenderer
from recast.simulation.rollout_files import load_coverage, save_coverage

_LOG = logging.getLogger(__name__)

_FAILURE = "failure.json"
_FILMS = "films.json"
_PLANNER = "planner.json"
_STATES = "states"
_COVERAGE = "coverage.parquet"
_VERSION: Literal[1] = 1
_MEND = "remove the folder of this rollout and run again"


class FilmsRecord(Record):
    """films.json: the film of each camera, whose name need not be that of a file."""

    version: Literal[1] = _VERSION
    films: dict[str, str]


class FailureRecord(Record):
    """failure.json: a `RolloutFailure`."""

    version: Literal[1] = _VERSION
    failure: RolloutFailure


class _Seen(BaseModel):
    """planner.json, see `seen_record`; members that nobody here reads may be anything."""

    model_config = ConfigDict(allow_inf_nan=False)

    views: tuple[ShownView, ...]


def make_rollout(
    setup: RolloutSetup,
    planner: Planner,
    renderer: SensorRenderer | None,
    folder: Path,
    on_step: Callable[[], None] = lambda: None,
    filmed: bool = True,
    timings: Timings | None = None,
    meter: Meter | None = None,
) -> None:
    """Run one rollout and write it into a folder.

    A rollout that is refused, or whose planner fails, is written as `failure.json`: a row of the
    report, not the end of the run.

    Args:
        renderer: None where nothing looks: no film, and a planner that needs no images.
        folder: empty; gets `states/` (see `save_rollout`), `planner.json` (see `seen_record`; with
            `restored_by`, the name of the restorer, if there is one), the films and `films.json`,
            and with a meter `coverage.parquet`; or `failure.json`.
        filmed: render every step, not only those that the planner sees.
        on_step: function that is called after each filmed step.
        timings: timings that those of the rollout are added to.
        meter: meter of the coverage of the actor that the renderer draws; None for an actor without
            shares.

    Raises:
        InputError: the disk refuses.
        UnreachableError: a program that plans or restores is not there.
    """
    with ExitStack() as opened:
        written: dict[str, str] = {}
        writers: dict[str, VideoWriter] = {}
        disk_refuses = False

        def film(state: SimState, images: Mapping[str, NDArray[np.uint8]]) -> None:
            nonlocal disk_refuses
            for name, image in images.items():
                try:
                    if name not in writers:
                        written[name] = f"{folder_name(name)}.mp4"
                        writer = VideoWriter(folder / written[name], fps=1 / setup.dt)
                        writers[name] = opened.enter_context(writer)
                    writers[name].add(image)
                except (OSError, InputError):
                    disk_refuses = True
                    raise
            on_step()

        try:
            on_frame = film if filmed else None
            rollout = run_rollout(setup, planner, renderer, on_frame, timings)
        except Exception as error:
            # No fault of the planner: the run ends, and is gone on with.
            if disk_refuses or isinstance(error, UnreachableError):
                raise
            _LOG.warning("rollout %s failed", setup.name, exc_info=True)
            opened.close()
            for name in written.values():
                (folder / name).unlink(missing_ok=True)
            write_failure(failure(setup, planner.name, error), folder)
            return
        opened.close()
        save_rollout(rollout, folder / _STATES)
        mounts = {} if renderer is None else renderer.mounts
        record = seen_record(planner, mounts)
        if isinstance(renderer, RestoringRenderer):
            record["restored_by"] = renderer.restored_by
        files.write_json(folder / _PLANNER, record)
        if meter is not None and mounts:
            names = tuple(setup.log.cameras if setup.camera_names is None else setup.camera_names)
            given = planner_cameras(planner, mounts, names)
            coverage = rollout_coverage(
                rollout, setup, meter, mounts, names if filmed else (), given
            )
            save_coverage(coverage, folder / _COVERAGE)
        if written:
            named = FilmsRecord(films=written)
            files.write_json(folder / _FILMS, named.model_dump(mode="json"))


def draw_films(rollout: Rollout, folder: Path) -> dict[str, Path]:
    """Films of a rollout that was run in this process, by camera; none without a renderer.

    Raises:
        ValueError: it was read from disk.
        InputError: the disk refuses.
    """
    origin = rollout.origin
    if origin is None:
        raise ValueError("draw_films: expected a rollout of this process, got one read from disk")
    if origin.renderer is None:
        return {}
    found = {}
    for name in origin.renderer.mounts:
        found[name] = folder / f"{folder_name(name)}.mp4"
        setup = origin.setup
        states = (
            rollout.state(step, other_poses(setup, rollout.timestamp_us(step)))
            for step in range(rollout.steps_run)
        )
        images = (origin.renderer.render(state, (name,))[name] for state in states)
        write_video(found[name], images, fps=1 / rollout.dt)
    return found


def read_rollout(folder: Path) -> Rollout | RolloutFailure:
    """Read what `make_rollout` wrote.

    Raises:
        InputError: the folder holds neither a rollout nor a failure.
    """
    path = folder / _FAILURE
    if not path.exists():
        return load_rollout(folder / _STATES)
    return read_record(path, FailureRecord, _VERSION, _MEND).failure


def read_coverage(folder: Path) -> RolloutCoverage | None:
    """What of the actor the cameras of a rollout saw; None if it was not measured.

    Raises:
        InputError: the file is damaged.
    """
    path = folder / _COVERAGE
    return load_coverage(path) if path.exists() else None


def given_views(folder: Path) -> tuple[ShownView, ...]:
    """What the planner of a rollout was given to see; () for one that looks at no images.

    Raises:
        InputError: the record is missing or damaged.
    """
    path = folder / _PLANNER
    try:
        return _Seen.model_validate(files.read_json(path)).views
    except ValidationError as error:
        raise validation_error(path, error, _MEND) from None


def films(folder: Path) -> dict[str, Path]:
    """Camera name to film.

    Raises:
        InputError: the record of the films is damaged, or names a file elsewhere.
    """
    path = folder / _FILMS
    if not path.exists():
        return {}
    record = read_record(path, FilmsRecord, _VERSION, _MEND)
    return {camera: member(folder, file, path, camera) for camera, file in record.films.items()}


def write_failure(row: RolloutFailure, folder: Path) -> None:
    """Write why there is no rollout into a folder."""
    record = FailureRecord(failure=row)
    files.write_json(folder / _FAILURE, record.model_dump(mode="json"))


def is_failure(folder: Path) -> bool:
    """Whether the folder says why there is no rollout."""
    return (folder / _FAILURE).exists()


def rollout_setup(
    log: DrivingLog,
    hdmap: HdMap,
    config: RunConfig,
    motion: ScriptedMotion,
    arm: str,
    start_left: float = 0.0,
) -> RolloutSetup:
    """What a run is asked for, as the setup of one rollout under the arm of a name."""
    return RolloutSetup(
        log=log,
        track_id=config.track,
        motion=motion,
        arm=arm,
        map=hdmap,
        steps=config.steps,
        plan_every=config.plan_every,
        keep_other_actors=config.keep_other_actors,
        camera_names=config.scene.cameras or tuple(log.cameras),
        start_left=start_left,
    )
