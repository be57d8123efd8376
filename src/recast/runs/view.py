"""`recast view`: what the words on the command line stand for, connected for the viewer."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import torch
from rich.console import Console

from recast.actors import Actor, load_actor
from recast.actors.vehicle_files import ACTOR_FILE
from recast.core.errors import InputError, require_range
from recast.logs import DrivingLog, HdMap, Trajectory, map_of, read_log
from recast.logs.store import LOG_FILE
from recast.runs.rollouts import is_failure, read_rollout
from recast.runs.run_folder import RUN_FILE
from recast.runs.view_run import drive_of, log_runner, named_place, run_inputs
from recast.scene import StreetScene, load_scene
from recast.scene.actor import SceneActor
from recast.scene.sky import SkyMap
from recast.scene.store import SCENE_FILE
from recast.simulation import RolloutFailure
from recast.viewer import (
    Page,
    ViewedDrive,
    ViewInputs,
    recording,
    require_viser,
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
    hdmap = None if log is None else _map(log)
    scenes: dict[str, StreetScene | None] = {}
    for path in kinds.get("scene", []):
        scenes[_free(path.name, scenes)] = load_scene(path)
    actors: dict[str, dict[str, Actor]] = {}
    for path in kinds.get("actor", []):
        actor = load_actor(path)
        base = next((s for s in scenes.values() if s is not None), None)
        name = _free(path.name, scenes)
        scenes[name] = alone(actor) if base is None else base.with_actor(actor)
        actors[name] = {actor.track_id: actor}
    title = ", ".join(path.name for paths in kinds.values() for path in paths)
    drives = _drives(log, scenes)
    scenarios: dict[str, dict[str, ViewedDrive]] = {_RECORDED: drives} if drives else {}
    if "rollout" in kinds:
        if log is None:
            raise InputError(
                kinds["rollout"][0],
                "WHAT",
                "is a rollout outside of a run folder",
                "name its log folder and its scene folder, too",
            )
        scenarios = _rollouts(kinds["rollout"], log, hdmap, scenes) | scenarios
    runner = None
    first = next((scene for scene in scenes.values() if scene is not None), None)
    if log is not None and hdmap is not None and log.tracks:
        runner = log_runner(log, hdmap, scenes, first)
    return ViewInputs(title, scenes, scenarios, log, hdmap, actors, runner)


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
    paths: Sequence[Path],
    log: DrivingLog,
    hdmap: HdMap | None,
    scenes: dict[str, StreetScene | None],
) -> dict[str, dict[str, ViewedDrive]]:
    """Drives of rollouts by motion and arm; an arm gets the scene of its name, or the first."""
    drives: dict[str, dict[str, ViewedDrive]] = {}
    first = next((scene for scene in scenes.values() if scene is not None), None)
    for path in paths:
        rollout = read_rollout(path)
        if isinstance(rollout, RolloutFailure):
            raise InputError(path, "rollout", f"failed: {rollout.reason}", "name another rollout")
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
