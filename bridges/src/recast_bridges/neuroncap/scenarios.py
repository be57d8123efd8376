"""NeuroNCAP's scenarios as scenario files of recast: one setting for each of its random runs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from recast.core import files
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
from recast_bridges.neuroncap.scenario_file import read_ncap_scenario
from recast_bridges.neuroncap.scenario_runs import NcapRun, ncap_runs

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
