"""`recast view`: what the words on the command line stand for, connected for the viewer."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from threading import Lock

import numpy as np
import torch
from rich.console import Console

from recast.actors import Actor, load_actor
from recast.actors.insert import insert
from recast.actors.vehicle_files import ACTOR_FILE
from recast.core import Artefact, Store
from recast.core.diagnostics import Progress
from recast.core.errors import InputError, require_range
from recast.core.files import folder_name
from recast.logs import DrivingLog, HdMap, Trajectory, map_of, read_log
from recast.logs.store import LOG_FILE
from recast.planning import Plan, Planner, PlannerAround, PlannerInput, make_planner
from recast.reconstruction.config import SceneConfig
from recast.runs.arms import Arm
from recast.runs.config import RunConfig
from recast.runs.rollouts import films, is_failure, read_rollout, rollout_setup, run_mounts
from recast.runs.run_folder import (
    ACTOR_FOLDER,
    RUN_FILE,
    RunFolder,
    rollout_name,
    use_name,
    use_parts,
)
from recast.scene import StreetScene, load_scene
from recast.scene.sky import SkyMap
from recast.scene.store import SCENE_FILE
from recast.scene.street_scene import SceneActor
from recast.simulation import (
    MOTIONS,
    Rollout,
    RolloutFailure,
    RolloutSetup,
    ScriptedMotion,
    camera_mounts,
    run_rollout,
)
from recast.simulation.scene_renderer import SceneRenderer, through_lenses
from recast.viewer import (
    FilmFile,
    FilmFrames,
    Page,
    Runner,
    ViewedDrive,
    ViewInputs,
    recording,
    require_viser,
    rollout_drive,
    scene_drive,
    still,
    write_replay,
)

_KINDS = {"run": RUN_FILE, "scene": SCENE_FILE, "actor": ACTOR_FILE, "log": LOG_FILE}
_STATES = "states"
_RECORDED = "recording"
_MOST = 8_000_000  # Gaussians, which fit into viser's texture
_MEND = "name folders of a log, scenes, actors, a run, or rollouts"


def view_inputs(what: Sequence[Path]) -> ViewInputs:
    """Load what shall be seen together.

    Args:
        what: one run folder; or rollouts of one run; or a log with scenes, actors and rollouts of
            it; or scenes or actors alone.

    Raises:
        InputError: a folder is none of these, or they do not go together.
    """
    found = [(kind_of_folder(path), path) for path in what]
    kinds = {kind: [path for one, path in found if one == kind] for kind, _ in found}
    runs = {path: run_of(path) for path in kinds.get("rollout", [])}
    if "run" in kinds or (runs and None not in runs.values()):
        folders = list(dict.fromkeys([*kinds.get("run", []), *filter(None, runs.values())]))
        if len(folders) > 1 or set(kinds) - {"run", "rollout"}:
            raise InputError(
                what[-1],
                "WHAT",
                "does not belong to the run that is shown",
                "show a run alone, or rollouts of one run",
            )
        return run_inputs(folders[0], [named_place(path) for path in runs])
    return _parts(kinds)


def kind_of_folder(path: Path) -> str:
    """ "run", "log", "scene", "actor" or "rollout".

    Raises:
        InputError: the folder is none of these.
    """
    if not path.is_dir():
        raise InputError(path, "WHAT", "is not a folder", _MEND)
    for kind, name in _KINDS.items():
        if (path / name).is_file():
            return kind
    if (path / _STATES).is_dir() or is_failure(path):
        return "rollout"
    raise InputError(path, "WHAT", "is not a folder that can be shown", _MEND)


def run_of(rollout: Path) -> Path | None:
    """The run folder through which a rollout is named, RUN/rollouts/MOTION/PLANNER/ARM."""
    path = named_place(rollout)
    above = path.parents[3] if len(path.parents) > 3 else None
    return above if above is not None and (above / RUN_FILE).is_file() else None


def _parts(kinds: dict[str, list[Path]]) -> ViewInputs:
    """A log, scenes, actors and rollouts that belong to no run folder."""
    if len(kinds.get("log", [])) > 1:
        raise InputError(kinds["log"][1], "WHAT", "is a second log", "name one log only")
    log = read_log(kinds["log"][0]) if "log" in kinds else None
    return parts_inputs(
        ", ".join(path.name for paths in kinds.values() for path in paths),
        log,
        [(path.name, load_scene(path)) for path in kinds.get("scene", [])],
        [(path.name, load_actor(path)) for path in kinds.get("actor", [])],
        [(_driven(path), path) for path in kinds.get("rollout", [])],
    )


def _driven(path: Path) -> Rollout:
    rollout = read_rollout(path)
    if isinstance(rollout, RolloutFailure):
        raise InputError(path, "rollout", f"failed: {rollout.reason}", "name another rollout")
    return rollout


def parts_inputs(
    title: str,
    log: DrivingLog | None,
    streets: Sequence[tuple[str, StreetScene]],
    actors: Sequence[tuple[str, Actor]],
    rollouts: Sequence[tuple[Rollout, Path | None]],
) -> ViewInputs:
    """A log, scenes, actors and rollouts that belong to no run folder.

    Args:
        streets, actors: with their names; each is an arm.
        rollouts: with the folders that have their films, if there are some.

    Raises:
        InputError: there are rollouts, but no log.
    """
    hdmap = None if log is None else _map(log)
    scenes: dict[str, StreetScene | None] = {}
    for name, street in streets:
        scenes[_free(name, scenes)] = street
    shown: dict[str, dict[str, Actor]] = {}
    base = streets[0][1] if streets else None
    for name, actor in actors:
        arm = _free(name, scenes)
        scenes[arm] = alone(actor) if base is None else base.with_actor(actor)
        shown[arm] = {actor.track_id: actor}
    drives = _drives(log, scenes)
    scenarios: dict[str, dict[str, ViewedDrive]] = {_RECORDED: drives} if drives else {}
    if rollouts:
        if log is None:
            raise InputError(
                rollouts[0][1] or "rollout",
                "WHAT",
                "is a rollout outside of a run folder",
                "name its log folder and its scene folder, too",
            )
        scenarios = _rollouts(rollouts, log, hdmap, scenes) | scenarios
    runner = None
    if log is not None and hdmap is not None and log.tracks:
        runner = log_runner(log, hdmap, scenes, base or next(iter(scenes.values())))
    return ViewInputs(title, scenes, scenarios, log, hdmap, shown, runner)


def _drives(
    log: DrivingLog | None, scenes: dict[str, StreetScene | None]
) -> dict[str, ViewedDrive]:
    """How things moved when it was recorded, in each scene."""
    recorded = None if log is None else recording(log)
    if not scenes and recorded is not None:
        scenes["log"] = None
    found: dict[str, ViewedDrive] = {}
    for name, scene in scenes.items():
        if recorded is not None:
            found[name] = recorded
        elif scene is not None:
            only = next(iter(scene.actors.values())) if len(scene.actors) == 1 else None
            lone = only is not None and len(scene.background) == 0
            found[name] = still(only) if lone and only is not None else scene_drive(scene)
    return found


def _rollouts(
    rollouts: Sequence[tuple[Rollout, Path | None]],
    log: DrivingLog,
    hdmap: HdMap | None,
    scenes: dict[str, StreetScene | None],
) -> dict[str, dict[str, ViewedDrive]]:
    """Drives of rollouts by motion and arm; an arm gets the scene of its name, or the first."""
    drives: dict[str, dict[str, ViewedDrive]] = {}
    first = next((scene for scene in scenes.values() if scene is not None), None)
    for rollout, path in rollouts:
        scenes.setdefault(rollout.arm, first)
        arms = drives.setdefault(f"{rollout.motion}-{rollout.setting}, {rollout.planner}", {})
        arms[rollout.arm] = drive_of(rollout, path, log, hdmap)
    return drives


def alone(actor: Actor) -> StreetScene:
    """A scene with an actor and nothing else, under a grey sky."""
    nothing = actor.gaussians.select(torch.zeros(0, dtype=torch.int64))
    there = Trajectory(np.zeros(1, np.int64), np.eye(4)[None])
    standing = SceneActor(
        actor.track_id,
        actor.gaussians,
        actor.size,
        there,
        shadow=actor.shadow,
        low_pass=actor.low_pass,
    )
    sky = SkyMap.constant(torch.full((3,), 0.6))
    return StreetScene(nothing, {actor.track_id: standing}, sky)


def _map(log: DrivingLog) -> HdMap | None:
    """The log's map, or one that is derived from it; None if the ego hardly drives."""
    try:
        return map_of(log)
    except InputError:
        return None


def _free(name: str, taken: Collection[str]) -> str:
    """The name, or one with a number that is not taken."""
    names = (name if n == 1 else f"{name} ({n})" for n in range(1, len(taken) + 2))
    return next(one for one in names if one not in taken)


def require_limits(
    what: Sequence[Path], port: int, most: int, replay: Path | None, most_mb: float
) -> None:
    """Refuse options that cannot work, before anything is loaded.

    Raises:
        InputError: viser is not installed, nothing is named, or a number is out of its range.
    """
    require_viser()
    if not what:
        raise InputError("recast view", "WHAT", "is missing", _MEND)
    require_range(1, 65535, port=port)
    require_range(1000, _MOST, max_gaussians=most)
    if not 0 < most_mb < float("inf"):
        raise InputError("`replay_mb`", "value", f"is {most_mb}", "give more than 0")
    if replay is not None and replay.suffix.lower() != ".html":
        raise InputError(replay, "`replay`", "is not an HTML file", "end its name in .html")


def serve_what(
    inputs: ViewInputs,
    host: str,
    port: int,
    most: int,
    out: Path,
    console: Console,
    names: Collection[str] = (),
) -> None:
    """Serve the page until the command is interrupted."""
    page = Page(inputs, most, out, host, port, [name.lower() for name in names])
    try:
        console.print(f"{page.pruned} shown", markup=False, highlight=False)
        console.print(f"open {page.url} in a browser; Ctrl+C ends", markup=False)
        with suppress(KeyboardInterrupt):
            page.server.sleep_forever()
    finally:
        page.close()


def replay_what(
    inputs: ViewInputs,
    path: Path,
    most_mb: float,
    most: int,
    scenario: str | None,
    console: Console,
) -> None:
    """Write a replay, and say what it came to."""
    size = write_replay(inputs, path, scenario=scenario, most_mb=most_mb, most=most)
    share = size.kept / size.total if size.total else 1.0
    console.print(
        f"wrote {path}: {size.bytes / 1e6:.1f} MB, {size.kept:,} of {size.total:,} Gaussians "
        f"({share:.0%})",
        markup=False,
        highlight=False,
    )


_PLANNERS = ("idm-follower", "constant-velocity", "log-replay")
_STEPS = 80
_SCALE = 0.5


def run_inputs(path: Path, only: Sequence[Path] = ()) -> ViewInputs:
    """Load what a run made.

    Args:
        only: folders of the rollouts that are shown; none for all.

    Raises:
        InputError: it is no run, its log or an artefact is gone, or none of its rollouts can be
            shown.
    """
    folder = RunFolder.open(path)
    log = read_log(folder.log_path)
    return _Opened(path, only, folder, folder.config, folder.store(), log).inputs()


def named_place(path: Path) -> Path:
    """A path from the root as it is named: links, which lead into the store, are not followed."""
    return Path(os.path.normpath(path.absolute()))


def drive_of(
    rollout: Rollout, folder: Path | None, log: DrivingLog, hdmap: HdMap | None
) -> ViewedDrive:
    """A rollout with the films beside it, in the folder that `make_rollout` wrote, if any."""
    kept = {} if folder is None else films(folder)
    found = {name: FilmFile(path, rollout.steps_run) for name, path in kept.items()}
    mounts = camera_mounts(log, [name for name in found if name in log.cameras])
    return rollout_drive(rollout, log, hdmap, mounts, found)


@dataclass(frozen=True)
class _Opened:
    path: Path
    only: Sequence[Path]
    folder: RunFolder
    config: RunConfig
    store: Store
    log: DrivingLog

    @cached_property
    def map(self) -> HdMap:
        return map_of(self.log)

    def inputs(self) -> ViewInputs:
        config = self.config
        scenarios: dict[str, dict[str, ViewedDrive]] = {}
        arms: dict[str, Arm] = {}
        for motion, planner, arm in product(config.motions, config.planners, config.arms):
            drive = self._drive(motion, planner, arm.name)
            if drive is not None:
                name = motion if len(config.planners) == 1 else f"{motion}, {planner}"
                scenarios.setdefault(name, {})[arm.name] = drive
                arms[arm.name] = arm
        if not scenarios:
            raise InputError(
                self.path,
                "rollouts",
                "none is finished",
                "finish the run: give its `recast run` command again",
            )
        actors = {name: self._actors(arm) for name, arm in arms.items() if arm.generates}
        scenes = _Scenes(
            arms, actors, lambda street: self._find(use_name("scene", street)), config.track
        )
        return ViewInputs(
            title=f"{self.path.absolute().name}: track {config.track} of {self.log.name}",
            scenes=scenes,
            scenarios=scenarios,
            log=self.log,
            hdmap=self.map,
            actors=actors,
            runner=run_runner(self.log, self.map, config, scenes),
        )

    def _drive(self, motion: str, planner: str, arm: str) -> ViewedDrive | None:
        link = named_place(self.path).joinpath(
            "rollouts", *(folder_name(name) for name in (motion, planner, arm))
        )
        if self.only and link not in self.only:
            return None
        found = self._find(rollout_name(motion, planner, arm))
        rollout = None if found is None else read_rollout(found.path)
        if found is None or rollout is None or isinstance(rollout, RolloutFailure):
            return None
        return drive_of(rollout, found.path, self.log, self.map)

    def _actors(self, arm: Arm) -> dict[str, Actor]:
        """An arm's vehicles by track: its target, and those of further tracks."""
        found: dict[str, Actor] = {}
        for use in self.folder.record.artefacts:
            what, *names = use_parts(use)
            if what == "actor" and names[0] == arm.name:
                artefact = self._find(use)
                assert artefact is not None  # the record names it
                actor = load_actor(artefact.path / ACTOR_FOLDER)
                found[actor.track_id] = actor
        return found

    def _find(self, use: str) -> Artefact | None:
        return self.folder.artefact(self.store, use)


class _Scenes(Mapping[str, StreetScene | None]):
    """The street of each arm with its vehicles, which are lit and put in when it is asked for.

    The target is left out where the arm does not show its Gaussians.
    """

    def __init__(
        self,
        arms: Mapping[str, Arm],
        actors: Mapping[str, Mapping[str, Actor]],
        find: Callable[[str], Artefact | None],
        target: str,
    ) -> None:
        self._arms, self._actors, self._find, self._target = arms, actors, find, target
        self._streets: dict[str, StreetScene | None] = {}
        self._made: dict[str, StreetScene | None] = {}
        self._lock = Lock()

    def __iter__(self) -> Iterator[str]:
        return iter(self._arms)

    def __len__(self) -> int:
        return len(self._arms)

    def __getitem__(self, name: str) -> StreetScene | None:
        arm = self._arms[name]
        with self._lock:
            if name not in self._made:
                scene = self._street(arm.street)
                if scene is not None:
                    for actor in self._actors.get(name, {}).values():
                        scene = insert(scene, actor, relit=arm.relit is not False)
                    if arm.vehicle in ("truth", "none"):
                        kept = {k: v for k, v in scene.actors.items() if k != self._target}
                        scene = replace(scene, actors=kept)
                self._made[name] = scene
            return self._made[name]

    def _street(self, name: str) -> StreetScene | None:
        if name not in self._streets:
            found = self._find(name)  # none: the truth, or a run that rendered nothing
            self._streets[name] = None if found is None else load_scene(found.path)
        return self._streets[name]


def run_runner(
    log: DrivingLog, hdmap: HdMap, config: RunConfig, scenes: Mapping[str, StreetScene | None]
) -> Runner:
    """Runs rollouts as a run does, with its planners, cameras and number of steps."""
    own = {name: config.motion(name) for name in config.motions}
    return _runner(log, hdmap, config, scenes, own)


def log_runner(
    log: DrivingLog,
    hdmap: HdMap,
    scenes: Mapping[str, StreetScene | None],
    first: StreetScene | None,
) -> Runner:
    """Runs rollouts on a log; the target is that of a synthetic log, or the first actor.

    Args:
        first: scene whose actors may be controlled; None: any track of the log.
    """
    modelled = [key for key in log.tracks if first is None or key in first.actors]
    wanted = log.metadata.get("target", "")
    track = wanted if wanted in modelled else next(iter(modelled or log.tracks))
    config = RunConfig(
        track=track,
        motions=(next(iter(MOTIONS)),),
        planners=_PLANNERS,
        steps=_STEPS,
        scene=SceneConfig(scale=_SCALE),
    )
    return _runner(log, hdmap, config, scenes, {})


def _runner(
    log: DrivingLog,
    hdmap: HdMap,
    config: RunConfig,
    scenes: Mapping[str, StreetScene | None],
    own: Mapping[str, ScriptedMotion],
) -> Runner:
    def run(motion: ScriptedMotion, word: str, arm: str, on_step: Progress) -> ViewedDrive:
        setup = rollout_setup(log, hdmap, config, motion, arm)
        return _run(setup, config, scenes.get(arm), word, on_step)

    planners = tuple(dict.fromkeys((*config.planners, *_PLANNERS)))
    return Runner(log, hdmap, config.track, {**own, **MOTIONS}, planners, config.steps, run)


class _Counted(PlannerAround):
    """A planner that tells how far the rollout has come."""

    def __init__(self, planner: Planner, on_step: Progress, steps: int) -> None:
        super().__init__(planner)
        self._on_step, self._steps = on_step, steps

    def plan(self, observation: PlannerInput) -> Plan:
        """See `Planner`."""
        self._on_step(observation.step, self._steps)
        return super().plan(observation)


def _run(
    setup: RolloutSetup, config: RunConfig, scene: StreetScene | None, word: str, on_step: Progress
) -> ViewedDrive:
    """Run one rollout, and film its first camera.

    Raises:
        InputError: the planner looks at images and the arm has no street, or the rollout is
            refused.
    """
    log, cameras = setup.log, setup.camera_names or ()
    planner = make_planner(word, config.planner_device)
    mounts = run_mounts(log, planner, config)
    renderer = None
    if scene is not None and config.track in scene.actors:
        street = scene
        renderer = through_lenses(mounts, lambda pinholes: SceneRenderer(street, pinholes))
    elif planner.needs_images:
        raise InputError(
            f"arm {setup.arm}",
            f"planner {word}",
            "needs images, but this arm has no scene to render",
            "choose another arm or planner",
        )
    total = 2 * config.steps if renderer is not None else config.steps
    rollout = run_rollout(setup, _Counted(planner, on_step, total), renderer)
    shown, film = {}, FilmFrames()
    if renderer is not None and cameras:
        camera = cameras[0]
        shown = {camera: mounts[camera]}
        for step in range(rollout.steps_run):
            film.add(renderer.render(rollout.state(step), (camera,))[camera])
            on_step(config.steps + step + 1, total)
    return rollout_drive(rollout, log, setup.hdmap, shown, dict.fromkeys(shown, film))
