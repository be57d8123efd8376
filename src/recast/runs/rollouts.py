"""One rollout of a run: its cameras, what renders it, and its finished folder with videos."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError
from rich.console import Console

from recast.actors import Actor
from recast.actors.actor import CoverageMeter
from recast.cameras import CameraMount
from recast.core import files
from recast.core.errors import InputError, UnreachableError
from recast.core.files import folder_name, member
from recast.core.records import Record, read_record, validation_error
from recast.logs import DrivingLog, HdMap
from recast.planning import (
    Planner,
    ShownView,
    planner_cameras,
    seen_lines,
    seen_record,
    shown_views,
    virtual_mounts,
)
from recast.reporting.video import VideoWriter, write_video
from recast.runs.arms import Arm
from recast.runs.config import RunConfig
from recast.scene import StreetScene
from recast.scene.street_scene import GapMeter, ViewGaps
from recast.simulation import (
    Rollout,
    RolloutFailure,
    RolloutSetup,
    ScriptedMotion,
    SensorRenderer,
    SimState,
    Timings,
    camera_mounts,
    failure,
    load_rollout,
    run_rollout,
    save_rollout,
)
from recast.simulation.renderer import RestoringRenderer, make_restorer
from recast.simulation.rollout_files import load_coverage, save_coverage
from recast.simulation.scene_renderer import (
    Meter,
    RolloutCoverage,
    RolloutGaps,
    SceneRenderer,
    rollout_coverage,
    rollout_gaps,
    through_lenses,
)

if TYPE_CHECKING:
    from recast.synthetic import World
    from recast.synthetic.write import OraclePool

_LOG = logging.getLogger(__name__)

_FAILURE = "failure.json"
_FILMS = "films.json"
_PLANNER = "planner.json"
_STATES = "states"
_COVERAGE = "coverage.parquet"
_GAPS = "gaps.json"
_VERSION: Literal[1] = 1
_MEND = "remove the folder of this rollout and run again"


def run_mounts(log: DrivingLog, planner: Planner, config: RunConfig) -> dict[str, CameraMount]:
    """The cameras that a run renders: the log's, at the scale of the scene, and `planner_mounts`.

    Raises:
        InputError: the configuration names a camera that the log lacks, or see `planner_mounts`.
    """
    mounts = camera_mounts(log, config.scene.cameras or None, config.scene.scale)
    return planner_mounts(mounts, planner, config)


def planner_mounts(
    mounts: Mapping[str, CameraMount], planner: Planner, config: RunConfig
) -> dict[str, CameraMount]:
    """The log's cameras, and virtual ones that the planner wants.

    nuPlan's have the scale of the scene, too: 1920x1080 at scale 1. InputError: see `shown_views`.
    """
    rendered = {**mounts, **virtual_mounts(planner, mounts, config.scene.scale)}
    shown_views(planner, rendered)
    return rendered


def require_distinct_planners(planners: Mapping[str, Planner]) -> None:
    """Refuse planners, by the word that asks for each, that results could not tell apart.

    Raises:
        InputError: two have the same name.
    """
    named: dict[str, str] = {}
    for word, planner in planners.items():
        other = named.setdefault(planner.name, word)
        if other != word:
            raise InputError(
                "`planner`",
                word,
                f"has the same name as {other}: {planner.name}",
                "give the planners different names",
            )


def announce_planner(
    planner: Planner, mounts: Mapping[str, CameraMount], console: Console, where: str = ""
) -> None:
    """Print, after `where` on each line, on which device the planner computes and what it sees."""
    said, warning = seen_lines(planner, mounts)
    if said:
        console.print(f"{where}{said}", markup=False, highlight=False)
    if warning:
        console.print(f"{where}warning: {warning}", markup=False, highlight=False, style="yellow")


StreetOf = Callable[[Arm, tuple[str, ...]], StreetScene]
"""Gives the street of an arm with the vehicles of these tracks replaced, if the arm does that."""


class Renderers:
    """Renderers, made when first asked for and kept; close it, as some hold processes.

    Args:
        actor_of: function that gives the vehicle that an arm puts in the place of a track.
        world_of: function that gives the world of a synthetic log.
        oracle_workers: processes of an oracle, see `OracleRenderer`.
        restorer: restorer of the images of arms that are `restorable`; None for no restorer.
    """

    def __init__(
        self,
        street_of: StreetOf,
        actor_of: Callable[[Arm, str], Actor],
        world_of: Callable[[], World],
        oracle_workers: int = 0,
        restorer: str | None = None,
    ) -> None:
        self._street_of, self._actor_of, self._world_of = street_of, actor_of, world_of
        self._oracle_workers, self._restorer = oracle_workers, restorer
        self._open = ExitStack()
        self._streets: dict[tuple[str, tuple[str, ...]], StreetScene] = {}
        self._made: dict[tuple[str, tuple[str, ...], str], SensorRenderer] = {}
        self._meters: dict[tuple[str, tuple[str, ...]], CoverageMeter | None] = {}
        self._gap_meters: dict[tuple[str, tuple[str, ...]], GapMeter] = {}

    def street(self, arm: Arm, tracks: tuple[str, ...]) -> StreetScene:
        """The reconstruction of an arm; `tracks` are replaced where it replaces any."""
        key = arm.name, tracks
        if key not in self._streets:
            self._streets[key] = self._street_of(arm, tracks)
        return self._streets[key]

    def of(
        self, arm: Arm, tracks: tuple[str, ...], planner: str, mounts: Mapping[str, CameraMount]
    ) -> SensorRenderer:
        """The renderer of an arm.

        Args:
            planner: name of the planner whose cameras are among `mounts`.
            tracks: tracks whose vehicles the arm exchanges or leaves out, the target first.

        Raises:
            InputError: the street has no such actor, or the log is not synthetic.
        """
        key = arm.name, tracks, planner
        if key not in self._made:
            if self._restores(arm) or arm.noise == "jitter":
                # What comes out for a pixel depends on others, beyond the window, too.
                mounts = {name: replace(mount, window=None) for name, mount in mounts.items()}
            made = through_lenses(mounts, lambda pinholes: self._make(arm, tracks, pinholes))
            self._made[key] = self._restored(arm, self._disturbed(arm, made))
        return self._made[key]

    def meter(self, arm: Arm, tracks: tuple[str, ...]) -> CoverageMeter | None:
        """What measures the coverage of an arm's target; None for a vehicle without shares."""
        if not arm.generates:
            return None
        key = arm.name, tracks
        if key not in self._meters:
            actor = self._actor_of(arm, tracks[0])
            self._meters[key] = (
                None
                if actor.shares is None
                else CoverageMeter(self.street(arm, tracks), actor.track_id, actor.shares)
            )
        return self._meters[key]

    def gap_meter(self, arm: Arm, tracks: tuple[str, ...]) -> GapMeter | None:
        """What measures the gaps of an arm's street; None where the street is the truth."""
        if arm.needs_world:
            return None
        key = arm.name, tracks
        if key not in self._gap_meters:
            self._gap_meters[key] = GapMeter(self.street(arm, tracks))
        return self._gap_meters[key]

    def _make(
        self, arm: Arm, tracks: tuple[str, ...], mounts: Mapping[str, CameraMount]
    ) -> SensorRenderer:
        """The renderer of cameras without distortion."""
        absent = tracks if arm.vehicle == "none" else ()
        if not arm.needs_world:
            return SceneRenderer(self.street(arm, tracks), mounts, absent=absent)
        # With the synthetic world, which needs a ray tracer.
        from recast.simulation.oracle_renderer import (
            GeneratedVehicleRenderer,
            OracleRenderer,
            TrueVehicleRenderer,
        )

        world, pool = self._world_of(), self._oracles
        if arm.reconstructs:
            street = self.street(arm, tracks)
            return TrueVehicleRenderer(world, street, mounts, tracks=tracks, pool=pool)
        if arm.generates:
            street = self.street(arm, tracks)
            return GeneratedVehicleRenderer(world, street, mounts, tracks=tracks, pool=pool)
        seed = 1 if arm.noise == "seed" else 0
        return OracleRenderer(world, mounts, tracks=absent, noise=seed, pool=pool)

    @cached_property
    def _oracles(self) -> OraclePool:
        """The oracle of all arms: processes that trace rays hold the whole world each."""
        from recast.synthetic.write import OraclePool

        return self._open.enter_context(OraclePool(self._world_of(), self._oracle_workers))

    def _disturbed(self, arm: Arm, renderer: SensorRenderer) -> SensorRenderer:
        if arm.noise not in ("grey", "jitter"):
            return renderer
        from recast.simulation.oracle_renderer import NoisyRenderer

        seed = self._world_of().seed if arm.needs_world else 0
        return NoisyRenderer(renderer, arm.noise, seed)

    def _restores(self, arm: Arm) -> bool:
        return self._restorer is not None and arm.restorable

    def _restored(self, arm: Arm, renderer: SensorRenderer) -> SensorRenderer:
        if self._restorer is None or not self._restores(arm):
            return renderer
        return RestoringRenderer(renderer, make_restorer(self._restorer))

    def close(self) -> None:
        """End the oracle's processes."""
        self._open.close()


class FilmsRecord(Record):
    """films.json: the film of each camera, whose name need not be that of a file."""

    version: Literal[1] = _VERSION
    films: dict[str, str]


class GapsRecord(Record):
    """Contents of gaps.json, see `RolloutGaps`."""

    version: int = _VERSION
    mean: ViewGaps
    worst: ViewGaps
    worst_s: float


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
    gap_meter: GapMeter | None = None,
) -> None:
    """Run one rollout and write it into a folder.

    A rollout that is refused, or whose planner fails, is written as `failure.json`: a row of the
    report, not the end of the run.

    Args:
        renderer: None where nothing looks: no film, and a planner that needs no images.
        folder: empty; gets `states/` (see `save_rollout`), `planner.json` (see `seen_record`; with
            `restored_by`, the name of the restorer, if there is one), the films and `films.json`,
            and with meters `coverage.parquet` and `gaps.json`; or `failure.json`.
        filmed: render every step, not only those that the planner sees.
        on_step: function that is called after each filmed step.
        timings: timings that those of the rollout are added to.
        meter: meter of the coverage of the actor that the renderer draws; None for an actor without
            shares.
        gap_meter: meter of the gaps in the street that the renderer draws; None for the truth.

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
        names = tuple(setup.log.cameras if setup.camera_names is None else setup.camera_names)
        given = planner_cameras(planner, mounts, names) if mounts else ()
        if gap_meter is not None and given:
            gaps = rollout_gaps(rollout, gap_meter, mounts, given)
            if gaps is not None:
                record = GapsRecord(**asdict(gaps)).model_dump(mode="json")
                files.write_json(folder / _GAPS, record)
        if meter is not None and mounts:
            coverage = rollout_coverage(rollout, meter, mounts, names if filmed else (), given)
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
        states = (rollout.state(step) for step in range(rollout.steps_run))
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


def read_gaps(folder: Path) -> RolloutGaps | None:
    """What a rollout's images showed that the log does not; None if it was not measured.

    Raises:
        InputError: the file is damaged.
    """
    path = folder / _GAPS
    if not path.exists():
        return None
    record = read_record(path, GapsRecord, _VERSION, _MEND)
    return RolloutGaps(record.mean, record.worst, record.worst_s)


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
    seed: int = 0,
    plan_limit_s: float | None = None,
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
        traffic=config.traffic,
        camera_names=config.scene.cameras or tuple(log.cameras),
        start_left=start_left,
        seed=seed,
        plan_limit_s=plan_limit_s,
        end_on_contact=config.end_on_contact,
    )
