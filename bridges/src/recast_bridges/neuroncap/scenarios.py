"""The random runs of a NeuroNCAP scenario in a log.

The draws are NeuroNCAP's own: a run has its index as seed, and random numbers are taken in the same
order from the same generator, so that run 3 here is its run 3.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.interpolate import make_interp_spline

from recast.arrays import Array, Int64Array
from recast.core import files
from recast.core.errors import InputError
from recast.logs.importers.nuscenes import KEY_FRAMES
from recast.logs.types import DrivingLog
from recast.simulation import (
    LoggedMotion,
    Scenario,
    ScenarioActor,
    ScriptedMotion,
    TimedPath,
    read_scenario,
    scenario_record,
)
from recast.simulation.actor_motion import AnyMotion
from recast_bridges.neuroncap.scenario_file import (
    Jitter,
    NcapFileActor,
    NcapScenario,
    read_ncap_scenario,
)

MOST_RUNS = 100
STEP = 0.1
"""Seconds."""
_STANDS = 1e-9
"""Metres to the next sample below which an actor stands."""
_SAME = 1e-6
"""Metres and radians: what is written is rounded to this."""


@dataclass(frozen=True)
class NcapRun:
    """One random run of a scenario.

    Attributes:
        seed: its index.
        target: track.
        steps: number of steps of 0.1 s from the end of the priming to the end of the scenario.
        motions: motions by track, the target first.
    """

    seed: int
    target: str
    steps: int
    motions: dict[str, TimedPath | LoggedMotion]

    @property
    def kinds(self) -> tuple[tuple[str, type], ...]:
        """Who does what kind of motion: runs of one file have the same."""
        first, *others = ((track, type(motion)) for track, motion in self.motions.items())
        return first, *sorted(others, key=lambda one: one[0])


def ncap_runs(
    scenario: NcapScenario, log: DrivingLog, runs: int, where: str | Path = "scenario"
) -> list[NcapRun]:
    """The runs 0 to `runs` - 1 of a scenario.

    Args:
        where: its file, for messages.

    Raises:
        InputError: the log has no key frames, too few of them, or lacks a track; a run has two
            targets or one track twice; or its target drives as logged.
    """
    if not 1 <= runs <= MOST_RUNS:
        raise InputError("`runs`", "value", f"is {runs}", f"give 1 to {MOST_RUNS}")
    frames = _key_frames(log)
    for actor in scenario.actors:
        for uuid in actor.uuids:
            if uuid not in log.tracks:
                mend = "give the log of the scene that the scenario was written for"
                raise InputError(where, f"uuid {uuid}", f"is not a track of {log.name}", mend)
    return [_Draw(scenario, log, frames, seed, where).run() for seed in range(runs)]


def _key_frames(log: DrivingLog) -> Int64Array:
    text = log.metadata.get(KEY_FRAMES, "")
    if not re.fullmatch(r"[0-9]{1,16}( [0-9]{1,16})*", text):
        mend = "import the nuScenes scene with recast log import nuscenes"
        raise InputError(log.name, f"metadata {KEY_FRAMES}", "has no key frames", mend)
    return np.array(text.split(), np.int64)


class _Draw:
    """One run."""

    def __init__(
        self,
        scenario: NcapScenario,
        log: DrivingLog,
        frames: Int64Array,
        seed: int,
        where: str | Path,
    ) -> None:
        self._scenario, self._log, self._frames = scenario, log, frames
        self._seed, self._where = seed, where

    def run(self) -> NcapRun:
        scenario, frames = self._scenario, self._frames
        first = scenario.start_frame
        if scenario.start_jitter:
            # With a generator of its own, as NeuroNCAP's engine has it.
            reach = scenario.start_jitter
            moved = int(np.random.default_rng(self._seed).integers(-reach, reach + 1))
            first = max(0, first + moved)
        driven = first + scenario.priming_steps
        if max(driven, scenario.start_frame) >= len(frames):
            problem = f"begins at key frame {driven}, but {self._log.name} has only {len(frames)}"
            mend = "give the log of the scene that the scenario was written for"
            raise self._fault(problem, mend)
        # In seconds after the first key frame, as times are in the file.
        seconds = (frames - frames[0]) * 1e-6
        left = scenario.duration - float(seconds[driven] - seconds[first])
        since = float(seconds[scenario.start_frame])
        count = int(scenario.duration * scenario.framerate)
        samples = np.linspace(0.0, scenario.duration, count) + since
        start = self._log.world_from_rig.timestamps_us[0]
        start_after = float(frames[driven] - start) * 1e-6
        if start_after < 0.0 or left < STEP:
            raise self._fault(
                "begins before the log, or ends within its priming steps", "use another log"
            )
        motions: dict[str, TimedPath | LoggedMotion] = {}
        targets: list[str] = []
        for actor, uuid, places, yaw in self._actors():
            if uuid in motions:
                raise self._fault(f"has the track {uuid} twice", "give each actor different uuids")
            setting = f"run-{self._seed}"
            motions[uuid] = LoggedMotion(setting)
            if not actor.optimized:
                path = _path(actor.times, places, yaw, samples)
                path[:, 0] -= seconds[driven]
                rows = tuple(tuple(row) for row in np.round(_pruned(path), 6).tolist())
                motions[uuid] = TimedPath(setting, rows)
            if actor.target:
                targets.append(uuid)
        if len(targets) > 1:
            raise self._fault(f"has {len(targets)} targets", "mark only one actor is_target_actor")
        target = targets[0] if targets else next(iter(motions))
        own = motions.pop(target)
        if not isinstance(own, TimedPath):
            problem = f"its target {target} follows its logged trajectory"
            raise self._fault(problem, "give the target the mode override")
        aimed = TimedPath(own.setting, own.path, round(start_after, 6))
        steps = int(left / STEP + _SAME)
        return NcapRun(self._seed, target, steps, {target: aimed, **motions})

    def _actors(self) -> list[tuple[NcapFileActor, str, Array, float]]:
        """Those of this run in the file's order, with track, places (N, 2) in the log's world, and
        yaw where they stand. The draws are made in a random order."""
        rng = np.random.default_rng(self._seed)
        drawn: dict[int, tuple[NcapFileActor, str, Array, float]] = {}
        groups: set[str] = set()
        for index in rng.permutation(len(self._scenario.actors)).tolist():
            actor = self._scenario.actors[index]
            if actor.group is not None:
                if actor.group in groups:
                    continue
                groups.add(actor.group)
            uuid = str(rng.choice(actor.uuids)) if actor.is_list else actor.uuids[0]
            places = np.array([place[:2] for place in actor.positions]).reshape(-1, 2)
            yaw = actor.yaw
            if actor.jitter is not None and not actor.optimized:
                offset, turn = _jittered(actor.jitter, rng)
                places, yaw = places + offset, yaw + turn
            if uuid in actor.flipped:
                yaw += np.pi
            drawn[index] = actor, uuid, places - self._log.world_offset[:2], yaw
        return [drawn[index] for index in sorted(drawn)]

    def _fault(self, problem: str, mend: str) -> InputError:
        return InputError(self._where, f"run {self._seed}", problem, mend)


def _jittered(jitter: Jitter, rng: np.random.Generator) -> tuple[Array, float]:
    """Offset (2,) of all places, and of the yaw; random numbers in NeuroNCAP's order."""

    def draw(scale: float) -> float:
        return float(rng.uniform(-scale, scale) if jitter.uniform else rng.normal(scale=scale))

    cos, sin, offset = np.cos(jitter.angle), np.sin(jitter.angle), np.zeros(2)
    if jitter.longitudinal is not None:
        offset += draw(jitter.longitudinal) * np.array([cos, sin])
    if jitter.lateral is not None:
        offset += draw(jitter.lateral) * np.array([sin, -cos])
    return offset, 0.0 if jitter.yaw is None else draw(jitter.yaw)


def _path(times: Sequence[float], places: Array, yaw: float, samples: Array) -> Array:
    """Rows (M, 4) of time, x, y and heading at the samples.

    Places are linear in time, beyond the ends too. The heading is that of the way to the next
    sample; where there is none, `yaw`.
    """
    xy = make_interp_spline(np.array(times), places, k=1)(samples)
    ahead = np.diff(xy, axis=0)
    ahead = np.concatenate([ahead, ahead[-1:]])
    heading = np.arctan2(ahead[:, 1], ahead[:, 0])
    heading[np.linalg.norm(ahead, axis=1) <= _STANDS] = yaw
    return np.concatenate([samples[:, None], xy, np.unwrap(heading)[:, None]], axis=1)


def _pruned(rows: Array) -> Array:
    """Without the rows that lie on the line between their neighbours."""
    kept = [0]
    for index in range(1, len(rows) - 1):
        last, this, following = rows[kept[-1]], rows[index], rows[index + 1]
        share = (this[0] - last[0]) / (following[0] - last[0])
        if np.abs(last + share * (following - last) - this).max() > _SAME:
            kept.append(index)
    return rows[[*kept, len(rows) - 1]]


_NAME_LENGTH = 24


@dataclass(frozen=True)
class ImportedFile:
    """A scenario file that was written.

    Attributes:
        path: path of the file.
        target: track that a run shall control.
        seeds: indices of the runs that are its settings.
        steps: number of steps of 0.1 s; the least of its runs.
    """

    path: Path
    target: str
    seeds: tuple[int, ...]
    steps: int


def import_ncap_scenario(
    path: Path, log: DrivingLog, out: Path, runs: int = 10, name: str | None = None
) -> list[ImportedFile]:
    """Write the runs of a scenario into a new folder: a file for each target, a setting a run.

    Args:
        path: NeuroNCAP's file.
        log: the nuScenes scene of the scenario.
        runs: number of runs; their seeds are 0, 1, ...
        name: what scenario names begin with; None for the names of the file and its folder.

    Raises:
        InputError: see `read_ncap_scenario` and `ncap_runs`; or the folder exists.
    """
    drawn = ncap_runs(read_ncap_scenario(path), log, runs, path)
    base = _plain(f"{path.absolute().parent.name}-{path.stem}" if name is None else name)
    groups: dict[tuple[tuple[str, type], ...], list[NcapRun]] = {}
    for run in drawn:
        groups.setdefault(run.kinds, []).append(run)
    written: list[ImportedFile] = []
    with files.atomic_folder(out) as folder:
        for group in groups.values():
            target = group[0].target
            same = sum(one.target == target for one in written)
            own = f"{base}-{_plain(target)[:8]}" + (f"-{same + 1}" if same else "")
            text = " ".join(f"NeuroNCAP's scenario {path.stem} in {log.name}.".split())
            made = [_scenario(run, own, text) for run in group]
            file = folder / f"{own}.yaml"
            record = yaml.safe_dump(_merged(made), sort_keys=False, default_flow_style=None)
            files.write_text(file, record)
            if read_scenario(file) != tuple(made):
                raise AssertionError(f"{file.name} does not read back")
            steps = min(run.steps for run in group)
            seeds = tuple(run.seed for run in group)
            written.append(ImportedFile(out / file.name, target, seeds, steps))
    return written


def _plain(text: str) -> str:
    """A word that names of scenarios may begin with."""
    word = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:_NAME_LENGTH].strip("-")
    return word or "ncap"


def _scenario(run: NcapRun, name: str, description: str) -> ScriptedMotion:
    (target, own), *others = run.motions.items()
    assert target == run.target and isinstance(own, TimedPath)  # from `_Draw.run`
    setting = own.setting
    motion = TimedPath(setting, own.path, own.start_after, name, description)
    further = tuple(ScenarioActor(track, _named(one)) for track, one in sorted(others))
    return Scenario(name, setting, motion, further, description) if further else motion


def _named(motion: TimedPath | LoggedMotion) -> AnyMotion:
    """With the name that a file gives a further actor's motion."""
    if isinstance(motion, TimedPath):
        return TimedPath(motion.setting, motion.path)
    return motion


def _merged(scenarios: Sequence[ScriptedMotion]) -> dict[str, Any]:
    """The contents of one file."""
    first, *others = (scenario_record(one) for one in scenarios)
    for record in others:
        first["settings"] |= record["settings"]
        for track, actor in record.get("actors", {}).items():
            first["actors"][track]["settings"] |= actor["settings"]
    return first
