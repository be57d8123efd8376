"""The library's face: the way of the data as functions of objects in memory.

What takes long is kept in a store and found again: `store/` beside the log's folder, unless another
is named. A log that lies in no folder has no store; its scenes and actors are made each time.

Every function also takes the folder of a log, scene or rollout in place of the object.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from rich.console import Console

from recast.actors import Actor, load_actor
from recast.actors.insert import require_model
from recast.core import Artefact, Store, folder_hash, open_store
from recast.core.arguments import Readers, checked
from recast.core.errors import InputError
from recast.core.plugins import SCENES
from recast.logs import DrivingLog, HdMap, load_log, map_of, write_log
from recast.metrics import RolloutMetric, RolloutMetrics, own_metrics, rollout_metrics
from recast.metrics.table import SAMPLES
from recast.reconstruction import (
    Preset,
    SceneConfig,
    SceneEvaluation,
    evaluate_scene,
    read_training_config,
    resolve_config,
)
from recast.reconstruction.train import CONFIG_FILE
from recast.runs.actor import ActorMakers
from recast.runs.arms import OWN_STREET
from recast.runs.making import (
    Maker,
    VehicleParts,
    refine_vehicle,
    register_vehicle,
    take_street,
    train_street,
)
from recast.runs.report import report_rollout, report_run
from recast.runs.run_folder import ACTOR_FOLDER, STORE_FOLDER
from recast.runs.sources import SourceLog, generator_source, segmenter_source
from recast.scene import StreetScene, save_scene
from recast.scene.exchange import IMPORT_FILE
from recast.simulation import Rollout, load_rollout
from recast.studies import BenchSettings, resolve_bench, run_closed_loop
from recast.studies.closed_loop import GridResults

if TYPE_CHECKING:
    from recast.studies.boundary import SearchAnswers  # needs the extra "search"
    from recast.viewer import Page

Place = str | Path | Store
_READERS: Readers = {DrivingLog: load_log, StreetScene: SCENES.resolve, Rollout: load_rollout}


@checked(_READERS)
def reconstruct(
    log: DrivingLog,
    *,
    preset: Preset | None = None,
    config: SceneConfig | None = None,
    store: Place | None = None,
    console: Console | None = None,
    **settings: Any,
) -> StreetScene:
    """Reconstruct the street of a log: background, actors and sky as 3D Gaussians.

    Every vehicle that the log saw well enough, moving or parked, is an actor of the scene. A scene
    that was made from the same log with the same settings is found again.

    Args:
        log: see `recast.load_log`.
        preset: "streetgs" or "omnire" for the method of that paper; None for recast's own.
        config: settings of the training; None for the defaults.
        store: folder or address of the artefacts; None for `store/` beside the log's folder.
        console: console that shows progress; None for silence.
        settings: single members of `SceneConfig`, such as `iterations=300`; they go over `config`.

    Raises:
        InputError: a setting or the log is at fault, or the disk refuses.

    >>> scene = reconstruct(log, iterations=20, scale=0.5)
    >>> "0" in scene.actors
    True
    """
    chosen = resolve_config(preset, config, settings)
    with _maker(log, store, console) as maker:
        made = train_street(maker, _source(log), chosen, preset or OWN_STREET)
        scene = load_scene(made.path)
        if store is None and log.origin is None:
            scene = replace(scene)  # without its origin, which is gone with the store
        return scene


def load_scene(source: Any) -> StreetScene:
    """The scene that a value stands for: a folder, "module:attribute", or a scene itself.

    Raises:
        InputError: it stands for none, or the folder is damaged.

    >>> load_scene(scene) is scene
    True
    """
    return SCENES.resolve(source)


@checked(_READERS)
def make_actor(
    log: DrivingLog,
    track: str,
    *,
    scene: StreetScene | None = None,
    generator: str = "auto",
    segmenter: str = "box-lidar",
    axes: str = "auto",
    views: int = 1,
    seed: int = 0,
    store: Place | None = None,
    console: Console | None = None,
) -> Actor:
    """Make the vehicle of a track complete from every side, and register it to boxes and LiDAR.

    Args:
        log: see `recast.load_log`.
        track: id of the vehicle's track; `recast log info` lists them.
        scene: scene that the vehicle is refined against, by all images of the log; None for no
            refinement.
        generator: a generator's name, a model's folder, a vehicle's file, or library:FOLDER.
        segmenter: a segmenter's name, or the folder of its networks.
        axes: orientation of a file or a model, see `recast.actors.axes_of`.
        views: largest number of views of the vehicle that the generator is given.
        seed: seed of the generator and the refinement.
        store: folder or address of the artefacts; None for `store/` beside the log's folder.
        console: console that shows progress; None for silence.

    Raises:
        InputError: no such track, generator or segmenter; the vehicle was not seen well enough; the
            scene has no model of the track.

    >>> actor = make_actor(log, "0", generator=f"{folder}/car.ply", axes="x,z")
    >>> actor.category
    'car'
    """
    if track not in log.tracks:
        known = ", ".join(log.tracks)
        raise InputError(log.name, f"track {track}", "is not in the log", f"choose one of {known}")
    if scene is not None:
        require_model(scene, track)
    parts = VehicleParts(
        generator,
        generator_source(generator),
        segmenter_source(segmenter),
        axes,
        views,
        lambda: ActorMakers.named(generator, segmenter, axes),
    )
    config = _config_of(scene)
    with _maker(log, store, console) as maker:
        made = register_vehicle(maker, _source(log), track, parts, seed, config)
        if scene is not None:
            made = refine_vehicle(maker, made, _scene_artefact(maker, scene), seed)
        return load_actor(made.path / ACTOR_FOLDER)


@checked(_READERS)
def evaluate(scene: StreetScene, log: DrivingLog, out: str | Path | None = None) -> SceneEvaluation:
    """Score a scene on the images of its log that were held out of its training.

    Args:
        out: folder for eval.json and pictures; None for none.

    Raises:
        InputError: no image was held out, or the disk refuses.

    >>> bool(evaluate(scene, log).whole.psnr > 5)
    True
    """
    return evaluate_scene(scene, log, _config_of(scene), out)


@checked(_READERS)
def score(
    rollout: Rollout,
    map: HdMap | DrivingLog | None = None,
    metrics: Sequence[str | RolloutMetric] = (),
) -> RolloutMetrics:
    """Score a rollout: NC, DAC, TTC, R_c, COM and their variants, each with its reason.

    Args:
        map: lanes and drivable area, or the log that has them; None for those of the log that the
            rollout was run on in this process.
        metrics: own metrics beside these, as objects or names; see `recast.metrics.BaseMetric`.

    Raises:
        InputError: the rollout was read from disk, and no map is given; or an own metric fails.

    >>> score(rollout).values["nc"].value
    1.0
    """
    if map is None and rollout.origin is not None:
        setup = rollout.origin.setup
        map = setup.hdmap or map_of(setup.log)
    if isinstance(map, DrivingLog):
        map = map_of(map)
    if map is None:
        raise InputError(
            rollout.name,
            "map",
            "is not stored in a rollout",
            "give the log of the rollout, or its map",
        )
    return rollout_metrics(rollout, map, own_metrics(metrics))


@checked(_READERS)
def write_report(
    result: Rollout | str | Path, out: str | Path, metrics: Sequence[str | RolloutMetric] = ()
) -> Path:
    """Write a rollout, or the folder of a run, as a page with pictures, plots and films.

    Args:
        result: a rollout that was run in this process, whose films are drawn now; or the folder of
            `recast run`.
        out: folder of the page; an earlier report there is replaced.
        metrics: own metrics of a rollout, see `score`; a run folder names its own.

    Returns:
        its `index.html`.

    Raises:
        InputError: `out` holds something else, or see `score`.

    >>> write_report(rollout, folder / "report").name
    'index.html'
    """
    if isinstance(result, Rollout):
        return report_rollout(result, score(result, metrics=metrics), Path(out))
    return report_run(result, out)


def show(
    *things: DrivingLog | StreetScene | Actor | Rollout | str | Path, port: int = 8080
) -> Page:
    """Show a log, scenes, actors and rollouts in the browser; see docs/view.md.

    A rollout that was run in this process brings its log, and its scene. In a notebook, the page
    appears below the cell. It is served until `close` of what is returned, or the end of Python.

    Args:
        things: objects, or folders alone, as `recast view` takes them.
        port: port of this machine; the next free one is taken if it is in use.

    Raises:
        InputError: nothing is given, a thing cannot be shown, they do not go together, or viser is
            not installed.

    >>> page = show(rollout)
    >>> page.close()
    """
    from recast.runs.view import parts_inputs, view_inputs
    from recast.viewer import Page

    if not things:
        raise InputError("show", "things", "are missing", "give a log, scene, actor or rollout")
    if all(isinstance(one, str | Path) for one in things):
        return Page(view_inputs([Path(str(one)) for one in things]), port=port)
    kinds = (DrivingLog, StreetScene, Actor, Rollout)
    strange = next((one for one in things if not isinstance(one, kinds)), None)
    if strange is not None:
        problem = f"cannot be shown beside objects: {type(strange).__name__}"
        raise InputError("show", "things", problem, "give objects alone, or folders alone")
    rollouts = [one for one in things if isinstance(one, Rollout)]
    origins = [one.origin for one in rollouts if one.origin is not None]
    logs = [one for one in things if isinstance(one, DrivingLog)]
    if len(logs) > 1:
        raise InputError("show", "things", "are of several logs", "show one log at a time")
    logs += [origin.setup.log for origin in origins if not logs]
    scenes = [one for one in things if isinstance(one, StreetScene)]
    rendered = [getattr(origin.renderer, "scene", None) for origin in origins if not scenes]
    scenes += [one for one in rendered if isinstance(one, StreetScene)][:1]
    actors = [(f"actor {one.track_id}", one) for one in things if isinstance(one, Actor)]
    inputs = parts_inputs(
        logs[0].name if logs else "recast",
        logs[0] if logs else None,
        [("scene" if len(scenes) == 1 else f"scene {i}", one) for i, one in enumerate(scenes, 1)],
        actors,
        [(one, None) for one in rollouts],
    )
    return Page(inputs, port=port)


@checked(_READERS)
def run_grid(
    scenes: Sequence[str],
    out: str | Path,
    *,
    arms: Sequence[str] = (),
    planners: Sequence[str] = (),
    motions: Sequence[str] = (),
    track: str | None = None,
    workers: int = 1,
    ray: str | None = None,
    quick: bool = False,
    store: str | Path | None = None,
    console: Console | None = None,
    samples: int = 200_000,
    **settings: Any,
) -> GridResults:
    """Run scenes x motions x planners x arms, and compare; what `recast bench closed-loop` does.

    Args:
        scenes: synthetic scenes such as "urban-straight:3", or log folders, LOG:TRACK.
        out: folder of the grid; one of the same settings is finished.
        arms: words for the arms, see docs/runs.md#arms; none for native and replaced.
        planners: names, folders, or "module:attribute"; none for "gtrs-mini".
        motions: names or scenario files; none for the paper's.
        track: target track of log folders that are named without one.
        workers: number of processes of this machine, or of actors of the cluster.
        ray: address of a Ray cluster.
        quick: small sizes, to try things.
        store: folder or address of the artefacts; None for `store/` beside `out`.
        console: console that shows progress and tables; None for silence.
        samples: number of bootstrap samples.
        settings: members of `RunConfig`, of `SceneConfig`, or of the synthetic drives (seconds,
            width, height).

    Raises:
        InputError: a setting is wrong, or `out` holds something else.

    >>> grid = run_grid([f"{folder}/log:0"], folder / "grid", motions=["advancing-a"], steps=10,
    ...                 planners=["idm-follower", "constant-velocity"], samples=100)
    >>> [(line.row.planner, line.row.arm) for line in grid.table][:2]
    [('idm-follower', 'native'), ('idm-follower', 'replaced')]
    """
    found = _bench(scenes, motions, arms, planners, track, quick, samples, settings)
    return run_closed_loop(
        found, Path(out), console or Console(quiet=True), workers=workers, ray=ray, store=store
    )


@checked()
def search(
    scenes: Sequence[str],
    out: str | Path,
    *,
    over: Sequence[str] = (),
    motions: Sequence[str] = (),
    fixed: Mapping[str, float] | None = None,
    objective: str = "at-fault",
    design: str = "boundary",
    trials: int = 60,
    arms: Sequence[str] = (),
    planners: Sequence[str] = (),
    track: str | None = None,
    fair_only: bool = True,
    workers: int = 1,
    ray: str | None = None,
    store: str | Path | None = None,
    database: str | Path | None = None,
    study: str | None = None,
    console: Console | None = None,
    **settings: Any,
) -> SearchAnswers:
    """Find where in a range of settings planners begin to fail; what `recast search` does.

    Args:
        scenes: synthetic scenes such as "urban-straight:3", or log folders, LOG:TRACK.
        out: folder of the study; one of the same settings goes on.
        over: settings to vary, such as "gap=2:40" or "delay=0,1,2"; none for gap=2:40.
        motions: motions whose settings are varied; none for cut-in-a.
        fixed: values of other settings.
        objective: what counts as a failure, see docs/search.md#objectives.
        design: how trials are chosen, see docs/search.md#designs.
        trials: number of trials for each log, motion, planner and arm.
        arms: words for the arms, see docs/runs.md#arms; none for native and replaced.
        planners: names, folders, or "module:attribute"; none for "gtrs-mini".
        track: target track of log folders that are named without one.
        fair_only: leave out scenarios that no driver could have mastered.
        workers, ray, store: see `run_grid`.
        database: SQLite file or address of the database; None for a file in `out`.
        study: name of the study in the database; None for the name of `out`.
        console: console that shows progress and results; None for silence.
        settings: members of `RunConfig`, of `SceneConfig`, or of the synthetic drives.

    Raises:
        InputError: a setting is wrong, or `out` or the database holds another study.

    >>> found = search([f"{folder}/log:0"], folder / "search", motions=["advancing-a"],
    ...                over=["gap=1:4"], design="grid", trials=3, arms=["native"],
    ...                planners=["idm-follower"], steps=10)
    >>> [(one.line.arm, len(one.trials), one.fails) for one in found.lines]
    [('native', 3, 0)]
    """
    from recast.studies.boundary import answers_of
    from recast.studies.search import resolve_search, run_search
    from recast.studies.search_page import print_search, write_search

    resolved = resolve_search(
        lambda named: _bench(scenes, named, arms, planners, track, False, SAMPLES, settings),
        motions=motions,
        over=over,
        fixed=fixed or {},
        objective=objective,
        design=design,
        trials=trials,
        seed=settings.get("seed", 0),
    )
    shown = console or Console(quiet=True)
    results = run_search(
        resolved,
        Path(out),
        shown,
        workers=workers,
        ray=ray,
        store=store,
        database=database,
        study=study,
    )
    answers = answers_of(results, fair_only)
    write_search(answers, Path(out))
    print_search(answers, shown)
    return answers


def _bench(
    scenes: Sequence[str],
    motions: Sequence[str],
    arms: Sequence[str],
    planners: Sequence[str],
    track: str | None,
    quick: bool,
    samples: int,
    settings: Mapping[str, Any],
) -> BenchSettings:
    """What a grid or a search runs; `settings` are members of all kinds."""
    drive = {name: settings[name] for name in _DRIVE if name in settings}
    scene = {name: settings[name] for name in settings if name in SceneConfig.model_fields}
    run = {
        name: value
        for name, value in settings.items()
        if name not in drive and (name not in scene or name == "seed")
    }
    return resolve_bench(
        words=list(scenes),
        track=track,
        motions=list(motions),
        quick=quick,
        config_file=None,
        scene_config_file=None,
        samples=samples,
        drive_options=drive,
        scene_options=scene,
        run_options={
            "films": False,
            **run,
            "arms": list(arms) or None,
            "planners": tuple(planners) or None,
        },
    )


_DRIVE = ("seconds", "width", "height")


@contextmanager
def _maker(log: DrivingLog, store: Place | None, console: Console | None) -> Iterator[Maker]:
    """A maker over the store of a log, or over one that is gone in the end."""
    with ExitStack() as opened:
        if store is None:
            if log.origin is None:
                folder = Path(opened.enter_context(TemporaryDirectory(prefix="recast-")))
            else:
                folder = log.origin.parent
            store = folder / STORE_FOLDER
        yield Maker(open_store(store), console or Console(quiet=True))


def _source(log: DrivingLog) -> SourceLog:
    if log.origin is not None:
        return SourceLog(log.origin, log, folder_hash(log.origin))
    with TemporaryDirectory(prefix="recast-") as folder:
        path = Path(folder) / "log"
        write_log(log, path)
        return SourceLog(path, log, folder_hash(path))


def _scene_artefact(maker: Maker, scene: StreetScene) -> Artefact:
    """The artefact of a scene in memory: by the folder it came from, or written now."""
    origin = scene.origin
    if origin is None:
        with TemporaryDirectory(prefix="recast-") as folder:
            save_scene(scene, Path(folder) / "scene")
            return take_street(maker, Path(folder) / "scene")
    if origin.parent.parent.parent == maker.store.root:
        return maker.store.open(f"{origin.parent.parent.name}/{origin.parent.name}")
    return take_street(maker, origin)


def _config_of(scene: StreetScene | None) -> SceneConfig:
    """What a scene was trained with: which images may be looked at, and which were held out."""
    folder = None if scene is None else scene.origin
    if folder is None or (folder / IMPORT_FILE).is_file() or not (folder / CONFIG_FILE).is_file():
        return SceneConfig()
    return read_training_config(folder)
