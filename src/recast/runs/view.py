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
from recast.core.errors import InputError, require_range
from recast.core.files import folder_name
from recast.logs import DrivingLog, HdMap, Trajectory, map_of, read_log
from recast.logs.store import LOG_FILE
from recast.reconstruction import load_preview, read_training_config, require_log_of
from recast.reconstruction.train import CHECKPOINT, FREE_FIELDS
from recast.runs.arms import TRUTH, Arm
from recast.runs.config import RunConfig
from recast.runs.page_runner import log_runner, run_runner
from recast.runs.rollouts import films, is_failure, read_rollout
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
    Rollout,
    RolloutFailure,
    camera_mounts,
)
from recast.viewer import (
    FilmFile,
    Page,
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


def run_inputs(path: Path, only: Sequence[Path] = ()) -> ViewInputs:
    """Load what a run made.

    Args:
        only: folders of the rollouts that are shown; none for all.

    A run that goes on shows what there is: the recorded drive until a rollout is finished, in the
    street of the training's last checkpoint until that is finished.

    Raises:
        InputError: it is no run, its log or an artefact is gone, or none of its rollouts can be
            shown.
    """
    written = written_ns(path / RUN_FILE)  # before all else: what is written later is news
    folder = RunFolder.open(path)
    log = read_log(folder.log_path)
    opened = _Opened(path, only, folder, folder.config, folder.store(), log)
    before = (written, *opened.trained())
    inputs = opened.inputs()
    if not opened.goes_on():
        return inputs

    def renew() -> ViewInputs | None:
        now = (written_ns(path / RUN_FILE), *opened.trained())
        return None if now == before else run_inputs(path, only)

    return replace(inputs, renew=renew)


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


def written_ns(file: Path) -> int | None:
    """When a file was last written, in nanoseconds; None if there is none."""
    try:
        return file.stat().st_mtime_ns
    except OSError:
        return None


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

    def goes_on(self) -> bool:
        """Whether rollouts of the run are not made yet."""
        config, made = self.config, self.folder.record.artefacts
        wanted = product(config.motions, config.planners, [arm.name for arm in config.arms])
        return any(rollout_name(*names) not in made for names in wanted)

    def trained(self) -> tuple[int | None, ...]:
        """When the checkpoints of streets in training were last written, in nanoseconds."""
        folders = [self._training(arm.made_in) for arm in self.config.arms]
        return tuple(written_ns(folder / CHECKPOINT) for folder in filter(None, folders))

    def inputs(self) -> ViewInputs:
        config = self.config
        scenarios: dict[str, dict[str, ViewedDrive]] = {}
        arms = {arm.name: arm for arm in config.arms}
        for motion, planner, arm in product(config.motions, config.planners, arms):
            drive = self._drive(motion, planner, arm)
            if drive is not None:
                name = motion if len(config.planners) == 1 else f"{motion}, {planner}"
                scenarios.setdefault(name, {})[arm] = drive
        if scenarios:
            shown = {arm for drives in scenarios.values() for arm in drives}
            arms = {name: arm for name, arm in arms.items() if name in shown}
        elif self.goes_on() and not self.only:
            streets = [name for name, arm in arms.items() if arm.vehicle == "own"]
            arms = {name: arms[name] for name in streets or arms}
            scenarios[_RECORDED] = dict.fromkeys(arms, recording(self.log))
        else:
            raise InputError(
                self.path,
                "rollouts",
                "none is finished",
                "finish the run: give its `recast run` command again",
            )
        actors = {name: self._actors(arm) for name, arm in arms.items() if arm.generates}
        steps: list[str] = []
        scenes = _Scenes(arms, actors, lambda street: self._street(street, steps), config.track)
        title = f"{self.path.absolute().name}: track {config.track} of {self.log.name}"
        if self.goes_on():
            list(scenes.values())  # the title tells of streets in training
            count = sum(map(len, scenarios.values())) if _RECORDED not in scenarios else 0
            total = len(config.motions) * len(config.planners) * len(config.arms)
            title = ", ".join([title, *steps, f"{count} of {total} rollouts"])
        return ViewInputs(
            title=title,
            scenes=scenes,
            scenarios=scenarios,
            log=self.log,
            hdmap=self.map,
            actors=actors,
            runner=run_runner(self.log, self.map, config, scenes),
        )

    def _street(self, name: str, steps: list[str]) -> StreetScene | None:
        """A street, or what its training has come to, whose step is added to `steps`."""
        found = self._find(use_name("scene", name))
        if found is not None:
            return load_scene(found.path)
        folder = self._training(name)
        with suppress(InputError):  # there is no checkpoint yet
            if folder is not None:
                scene, step = load_preview(folder, self.log)
                steps.append(f"street after {step} steps of training")
                return scene
        return None  # the truth, or a run that rendered nothing

    def _training(self, name: str) -> Path | None:
        """The folder in which a street of this run is trained, or was when it was stopped."""
        if name == TRUTH or use_name("scene", name) in self.folder.record.artefacts:
            return None
        free = {*FREE_FIELDS, "force_dynamic"}  # the run adds its track to the latter
        wanted = self.config.street(name).model_dump(exclude=free)
        for folder in self.store.partial("scenes"):
            with suppress(InputError):
                require_log_of(folder, self.log)
                if read_training_config(folder).model_dump(exclude=free) == wanted:
                    return folder
        return None

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
        find: Callable[[str], StreetScene | None],
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
            self._streets[name] = self._find(name)
        return self._streets[name]
