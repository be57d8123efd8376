"""Logs and scenarios for other programs: `recast log export`, `scenario export`, `scenario import`;
scores of other benchmarks: `recast eval rollouts`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from recast.cli import shared
from recast.cli.shared import JSON, Rows, console_for, print_json, with_unit
from recast.core.errors import InputError

if TYPE_CHECKING:
    from recast_bridges.neuroncap import ImportedFile
    from recast_bridges.openx import Exported, ExportedRoads
    from recast_bridges.scores.stored import ForeignScores, ScoreRow


@dataclass(frozen=True)
class LogExport:
    """Write a log for another program: the scene bundle that AlpaSim's runtime reads.

    The bundle has poses, calibration, tracks and map; images come from `recast serve sensorsim`.
    """

    format: tyro.conf.Positional[Literal["alpasim"]]
    """Kind of the file: alpasim (a USDZ package)."""
    log: tyro.conf.Positional[str]
    """Log folder, or its address in object storage, such as s3://bucket/folder."""
    out: Path
    """File to write, NAME.usdz; must not exist."""
    scene: Annotated[
        str | None,
        shared.option(
            "Id under which `recast serve sensorsim` offers the scene.", "the log's name"
        ),
    ] = None
    map: bool = True
    """Write the map of the log into the bundle."""

    def __call__(self) -> None:
        from recast.logs import load_log
        from recast_bridges.alpasim import export_bundle

        told = export_bundle(load_log(self.log), self.out, self.scene, with_map=self.map)
        lines = [
            f"wrote {self.out}: scene {told.scene_id}, {told.cameras} cameras, "
            f"{told.tracks} tracks, {told.lanes} lanes"
        ]
        if told.tracks_left_out:
            lines.append(f"left out {told.tracks_left_out} tracks with a single label")
        if told.frames_left_out:
            lines.append(
                f"left out {told.frames_left_out} camera frames at the first pose of the ego"
            )
        for line in lines:
            console_for(False).print(line, markup=False, highlight=False, soft_wrap=True)


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
    """Write scenarios and rollouts of a log to a folder. Raises InputError: neither is named; a
    scenario cannot run on the log; a rollout is not of it."""
    from recast.cli.rows.logs import target_of
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


@dataclass(frozen=True)
class ScenarioImport:
    """Read a scenario file of NeuroNCAP and write its random runs as scenario files, one for each
    vehicle that is the target of some of them."""

    layout: tyro.conf.Positional[Literal["neuroncap"]]
    """Format of the file."""
    path: tyro.conf.Positional[Path]
    """Scenario file (YAML), such as scenarios/side/0103.yaml."""
    log: Annotated[Path, shared.required("Log folder of the nuScenes scene of the scenario.")]
    out: Path
    """Folder to write; must not exist."""
    runs: int = 10
    """Number of runs, at most 100. Their seeds are 0, 1, ..., as in NeuroNCAP."""
    name: Annotated[
        str | None,
        shared.option(
            "What the names of the scenarios begin with.", "names of the file and its folder"
        ),
    ] = None
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.logs import read_log
        from recast_bridges.neuroncap import import_ncap_scenario

        log = read_log(self.log)
        written = import_ncap_scenario(self.path, log, self.out, self.runs, self.name)
        console = console_for(self.json)
        for line in import_lines(written, self.log):
            console.print(line, markup=False, highlight=False, soft_wrap=True)
        if self.json:
            print_json(import_rows(written))


def import_lines(written: Sequence[ImportedFile], log_path: Path) -> list[str]:
    """What was written, and the command that runs each file."""
    lines = []
    for one in written:
        runs = ", ".join(map(str, one.seeds))
        lines.append(f"{one.path}: runs {runs}; target {one.target}")
        lines.append(
            f"  recast run {log_path} --track {one.target} --motion {one.path} "
            f"--steps {one.steps} --out RUN"
        )
    return lines


def import_rows(written: Sequence[ImportedFile]) -> Rows:
    """One row for each file."""
    rows = [
        {"file": one.path, "track_id": one.target, "runs": list(one.seeds), "steps": one.steps}
        for one in written
    ]
    return {"scenarios": rows}


@dataclass(frozen=True)
class EvalRollouts:
    """Score the rollouts of a run by the rules of NAVSIM v2 (EPDMS of every plan), AlpaSim and
    NeuroNCAP."""

    run: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    """Folder of `recast run`."""
    out: Annotated[
        Path | None, shared.option("File for the scores of each rollout and plan, as JSON.")
    ] = None
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.core.diagnostics import ProgressBar
        from recast_bridges.scores.stored import score_rows, score_run, score_table, write_scores

        console = console_for(self.json)
        with ProgressBar("rollouts", console) as progress:
            scores = score_run(self.run, progress)
        if self.out is not None:
            write_scores(scores, self.out)
            console.print(f"wrote {self.out}", markup=False)
        rows = score_rows(scores)
        if self.json:
            print_json(_json_rows(rows, scores))
            return
        console.print(score_table(rows))


def _json_rows(rows: Sequence[ScoreRow], scores: Sequence[ForeignScores]) -> Rows:
    """Means of each planner and arm, and the scores of each rollout with their reasons."""
    from recast_bridges.scores.stored import SCORES

    keys = {key: with_unit(key, column.unit) for key, column in SCORES.items()}
    arms = [
        {
            "planner": row.planner,
            "arm": row.arm,
            "rollouts": row.rollouts,
            **{keys[key]: mean for key, mean in row.means.items()},
            **{f"{key}_rollouts": count for key, count in row.counts.items()},
        }
        for row in rows
    ]
    rollouts = [
        {
            "rollout": one.name,
            "planner": one.planner,
            "arm": one.arm,
            "motion": f"{one.motion}-{one.setting}",
            **{
                keys[key]: None if metric.value is None else SCORES[key].scale * metric.value
                for key, metric in one.values.items()
            },
            **{f"{key}_reason": metric.reason for key, metric in one.values.items()},
        }
        for one in scores
    ]
    return {"arms": arms, "rollouts": rollouts}
