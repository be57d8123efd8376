"""A run folder for the viewer: streets with the vehicles of each arm, rollouts old and new."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from threading import Lock

from recast.actors import Actor, load_actor
from recast.actors.insert import insert
from recast.core import Artefact, Store
from recast.core.errors import InputError
from recast.core.names import folder_name
from recast.core.progress import Progress
from recast.logs import DrivingLog, HdMap, map_of, read_log
from recast.planning import (
    Plan,
    Planner,
    PlannerAround,
    PlannerInput,
    make_planner,
)
from recast.reconstruction import SceneConfig
from recast.runs.arms import Arm
from recast.runs.config import RunConfig
from recast.runs.layout import ACTOR_FOLDER, rollout_name, use_name, use_parts
from recast.runs.planner_cameras import run_mounts
from recast.runs.rollouts import films, read_rollout, rollout_setup
from recast.runs.run_folder import RunFolder
from recast.scene import StreetScene, load_scene
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
from recast.viewer import FilmFile, FilmFrames, Runner, ViewedDrive, ViewInputs, rollout_drive

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


def drive_of(rollout: Rollout, folder: Path, log: DrivingLog, hdmap: HdMap | None) -> ViewedDrive:
    """A rollout with the films beside it, in the folder that `make_rollout` wrote."""
    found = {name: FilmFile(path, rollout.steps_run) for name, path in films(folder).items()}
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
