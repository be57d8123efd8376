"""`recast scenario export`: OpenSCENARIO and OpenDRIVE."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from recast.cli import shared
from recast.cli.output import JSON, Rows, console_for, print_json
from recast.core.errors import InputError

if TYPE_CHECKING:
    from recast_bridges.openx import Exported, ExportedRoads


@dataclass(frozen=True)
class ScenarioExport:
    """Write scenarios on a log, or driven rollouts, as OpenSCENARIO XML with the map as OpenDRIVE;
    every file is read back and compared."""

    log: tyro.conf.Positional[Path]
    """Log folder."""
    out: Path
    """Folder to write; must not exist."""
    motion: Annotated[shared.Names, shared.option(shared.MOTION_HELP)] = ()
    rollout: Annotated[
        tuple[Path, ...],
        shared.option("Rollout folders of this log: RUN/rollouts/SCENARIO/PLANNER/ARM/states."),
    ] = ()
    track: Annotated[
        str | None,
        shared.option(shared.TRACK_HELP, "target of a synthetic log, else the first track"),
    ] = None
    steps: Annotated[int, shared.STEPS] = 160
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        written = export_scenarios(
            self.log, self.out, self.motion, self.rollout, self.track, self.steps
        )
        console = console_for(self.json)
        for line in (*export_lines(*written), f"wrote {self.out}"):
            console.print(line, markup=False, highlight=False)
        if self.json:
            print_json(export_rows(*written))


def export_scenarios(
    log_path: Path,
    out: Path,
    motions: Sequence[str],
    rollouts: Sequence[Path],
    track: str | None,
    steps: int,
) -> tuple[list[Exported], ExportedRoads | None]:
    """Write scenarios and rollouts of a log to a folder.

    Raises:
        InputError: neither is named; a scenario cannot run on the log; a rollout is not of it.
    """
    from recast.cli.rows.scenarios import target_of
    from recast.logs import map_of, read_log
    from recast.simulation import RolloutSetup, load_rollout, parse_motions, scenario_name
    from recast_bridges.openx import export_openx, played_rollout, played_scenario

    if not motions and not rollouts:
        mend = "name a motion (`--motion cut-in-a`) or a rollout folder (`--rollout`)"
        raise InputError("command line", "`motion`", "is missing, and so is a rollout", mend)
    log = read_log(log_path)
    hdmap = map_of(log)
    played = []
    for motion in (one for name in motions for one in parse_motions(name)):
        target = target_of(log) if track is None else track
        setup = RolloutSetup(log, target, motion, map=hdmap, steps=steps)
        played.append(replace(played_scenario(setup), name=scenario_name(motion)))
    played += [played_rollout(load_rollout(folder), log) for folder in rollouts]
    return export_openx(played, hdmap, out, log.name)


def export_lines(exported: Sequence[Exported], roads: ExportedRoads | None) -> list[str]:
    """What was written, and how far what is read back is from it."""
    lines = [
        f"{one.file}: {one.entities} road users; read back: {one.metres:.1g} m, "
        f"{one.seconds:.1g} s apart at most"
        for one in exported
    ]
    if roads is None:
        return [*lines, "no road file: the log has no lanes"]
    told = (
        f"map.xodr: {roads.lanes} lanes; read back: boundaries {roads.metres:.2g} m, "
        f"centrelines {roads.centreline_metres:.2g} m apart at most"
    )
    if roads.left_out.links:
        told += f"; {roads.left_out.links} links left out where lanes part and join at once"
    if roads.left_out.neighbours:
        told += f"; {roads.left_out.neighbours} pairs of neighbours are roads of their own"
    return [*lines, told]


def export_rows(exported: Sequence[Exported], roads: ExportedRoads | None) -> Rows:
    """One row for each file."""
    scenarios = [
        {
            "file": one.file,
            "entities": one.entities,
            "difference_m": one.metres,
            "difference_s": one.seconds,
        }
        for one in exported
    ]
    if roads is None:
        return {"scenarios": scenarios, "roads": []}
    row = {
        "file": "map.xodr",
        "lanes": roads.lanes,
        "difference_m": roads.metres,
        "centreline_difference_m": roads.centreline_metres,
        "links_left_out": roads.left_out.links,
        "neighbours_left_out": roads.left_out.neighbours,
    }
    return {"scenarios": scenarios, "roads": [row]}
