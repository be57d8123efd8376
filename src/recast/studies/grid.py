"""A grid: what it is asked to be, its record in its folder, its rollouts as rows, and their table.

The table has intervals over scenes, and how the arms differ."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from recast.arrays import Array
from recast.core import files, folder_hash
from recast.core.errors import InputError, require_range
from recast.core.files import folder_name
from recast.logs import DrivingLog, read_log
from recast.metrics.scene_level_images import FrameRule, logged_frames
from recast.metrics.table import (
    COLUMNS,
    MOST_EXACT,
    SAMPLES,
    Bootstrap,
    Metric,
    TableRow,
    cluster_bootstrap,
    column_of,
    columns_of,
    exact_bootstrap,
    invalid,
    matched_pairs,
    table,
)
from recast.reconstruction.config import SceneConfig
from recast.reconstruction.views import modelled_tracks
from recast.runs.config import RunConfig, given, resolve_config
from recast.runs.run_folder import claim_empty, first_difference
from recast.runs.sources import require_track
from recast.simulation import camera_mounts
from recast.synthetic import SCENES

ALL_SYNTHETIC = "synthetic"
"""The word for every synthetic scene."""
RECORD_FILE, ROLLOUTS_FILE, RESULTS_FILE = "bench.json", "rollouts.parquet", "results.json"
TIMES_FILE, SCENES_FOLDER = "times.json", "scenes"
BENCH_FORMAT, BENCH_VERSION = "recast-closed-loop", 2
AUTO_TRACK = "auto"
"""The word for the target that `choose_target` chooses."""
PAPER_SEGMENTS: Mapping[str, str] = {
    "002": "segment-1005081002024129653_5313_150_5333_150",
    "011": "segment-10153695247769592104_787_000_807_000",
    "034": "segment-10625026498155904401_200_000_220_000",
    "046": "segment-10923963890428322967_1445_000_1465_000",
    "137": "segment-1306458236359471795_2524_330_2544_330",
    "152": "segment-13310437789759009684_2645_000_2665_000",
    "161": "segment-1352150727715827110_3710_250_3730_250",
    "162": "segment-1357883579772440606_2365_000_2385_000",
    "177": "segment-13940755514149579648_821_157_841_157",
}
"""Waymo Open Dataset segments by the paper's numbers, read as numbers of the training list that
Street Gaussians, EmerNeRF and DriveStudio share (the paper does not say which list it means)."""
ANY_TRACK = "*"
"""Stands in `BenchSettings.run` for the track, which every scene has its own of."""
MOTIONS = ("cut-in", "oncoming", "stationary")
"""The paper's, with both settings each."""


@dataclass(frozen=True)
class BenchScene:
    """A scene of a grid.

    Attributes:
        id: its name in results and its folder below OUT/scenes.
        world, seed: name and seed of a synthetic world, None for a recorded scene.
        log, track: folder and target track of a recorded drive, None for a synthetic scene.
    """

    id: str
    world: str | None = None
    seed: int | None = None
    log: Path | None = None
    track: str | None = None


def parse_scenes(words: Sequence[str], seed: int, track: str | None = None) -> list[BenchScene]:
    """The scenes that words stand for, in their order.

    Args:
        words: a synthetic scene, such as "urban-straight" or "urban-straight:3" with its seed; the
            word "synthetic", for all of them; a log folder with its target, LOG:TRACK; or a log
            folder alone, if `track` is given.
        seed: seed of synthetic scenes without one.
        track: target track of log folders without one. The track `auto` is the one that
            `choose_target` chooses.

    Raises:
        InputError: no scene; an unknown one; a log that cannot be read or lacks the track; the same
            scene twice.
    """
    scenes = [scene for word in words for scene in _parse(word, seed, track)]
    if not scenes:
        raise InputError(
            "`scenes`", "value", "names no scene", f"give one or more of {', '.join(SCENES)}"
        )
    seen: set[str] = set()
    for scene in scenes:
        if scene.id in seen:
            raise InputError("`scenes`", scene.id, "is given twice", "give each scene once")
        seen.add(scene.id)
    return scenes


def _parse(word: str, seed: int, track: str | None) -> list[BenchScene]:
    if word == ALL_SYNTHETIC:
        return [_synthetic(name, seed) for name in SCENES]
    name, colon, rest = word.rpartition(":")
    if not colon:
        name, rest = word, ""
    if name in SCENES:
        if colon and not re.fullmatch(r"[0-9]+", rest):
            problem = f"{rest!r} is not a seed"
            raise InputError("`scenes`", word, problem, "give a number, 0 or more")
        return [_synthetic(name, int(rest) if colon else seed)]
    # a whole word that is a folder wins, since paths may hold colons
    if Path(word).is_dir() and track is not None:
        return [_recorded(Path(word), track)]
    if colon and Path(name).is_dir():
        return [_recorded(Path(name), rest)]
    if Path(word).is_dir():
        raise InputError(
            "`scenes`", word, "names no track to control", "write LOG:TRACK, or give `track`"
        )
    raise InputError(
        "`scenes`",
        word,
        "is neither a synthetic scene nor a log folder",
        f"choose one of {', '.join(SCENES)}, write {ALL_SYNTHETIC} for all, or give LOG:TRACK",
    )


def _synthetic(name: str, seed: int) -> BenchScene:
    return BenchScene(f"{name}-{seed}", world=name, seed=seed)


def _recorded(path: Path, track: str) -> BenchScene:
    log = read_log(path)
    if track == AUTO_TRACK:
        track = choose_target(log)
    require_track(log, path, track)
    return BenchScene(folder_name(f"{log.name}-{track}"), log=path, track=track)


def choose_target(log: DrivingLog) -> str:
    """The target where the paper names none: the vehicle with the most logged images that count.

    Images count as in the scene-level evaluation (`FrameRule`); among equals, the first by id.

    Raises:
        InputError: no vehicle has such an image.
    """
    cameras = [(name, mount.camera) for name, mount in camera_mounts(log).items()]
    counts = {
        track: sum(1 for _ in logged_frames(log, track, cameras, FrameRule()))
        for track in sorted(modelled_tracks(log, SceneConfig()))
    }
    best = max(counts, key=lambda track: counts[track], default=None)
    if best is None or counts[best] == 0:
        raise InputError(
            log.name,
            "track auto",
            "no vehicle is seen well enough",
            "name a track of `recast log info`",
        )
    return best


@dataclass(frozen=True)
class DriveSize:
    """Size of the synthetic scenes: seconds of the drive, and pixels of its images."""

    seconds: float = 20.0
    width: int = 480
    height: int = 320


@dataclass(frozen=True)
class BenchSettings:
    """A grid.

    Attributes:
        run: motions, arms (the first is the baseline), planners and all else, the same for every
            scene; its track is `ANY_TRACK`.
    """

    scenes: tuple[BenchScene, ...]
    run: RunConfig
    drive: DriveSize = DriveSize()
    samples: int = SAMPLES

    def run_of(self, track: str) -> RunConfig:
        """The configuration of a scene whose target is `track`: on one thread, as all workers."""
        scene = self.run.scene.model_copy(update={"threads": 1})
        streets = {
            name: street.model_copy(update={"threads": 1})
            for name, street in self.run.streets.items()
        }
        update = {"track": track, "threads": 1, "scene": scene, "streets": streets}
        return self.run.model_copy(update=update)

    def absolute(self) -> Self:
        """The same with absolute paths of logs, for workers with another working folder."""
        scenes = (
            scene if scene.log is None else replace(scene, log=scene.log.absolute())
            for scene in self.scenes
        )
        return replace(self, scenes=tuple(scenes))

    def record(self) -> dict[str, Any]:
        """What makes this grid another than others: plain data, without where files lie.

        The member `config` is the configuration of a run, so that a configuration file may be one.
        """
        return {
            "format": BENCH_FORMAT,
            "version": BENCH_VERSION,
            "config": self.run.resolved(),
            "drive": asdict(self.drive),
            "samples": self.samples,
            "scenes": [_scene_record(scene) for scene in self.scenes],
        }


def begin(out: Path, record: Mapping[str, Any], file: str = RECORD_FILE) -> None:
    """Take `out` for the grid or search of this record, or go on with it there.

    Raises:
        InputError: it holds something else; nothing is written then.
    """
    path = out / file
    if path.is_file():
        found = files.read_json(path)
        if not isinstance(found, dict) or found.get("format") != record["format"]:
            problem = f"is not that of a {record['format']}"
            raise InputError(path, "format", problem, "give another `out`")
        differing = first_difference({name: found.get(name) for name in record}, dict(record))
        if differing is not None:
            raise InputError(
                path,
                differing,
                "differs: the folder contains other work",
                "give another `out`, or repeat the options that it was made with",
            )
        return
    claim_empty(out, file)
    files.write_json(path, record)


def _scene_record(scene: BenchScene) -> dict[str, Any]:
    if scene.log is None:
        return {"id": scene.id, "world": scene.world, "seed": scene.seed}
    return {"id": scene.id, "log": folder_hash(scene.log), "track": scene.track}


_QUICK_DRIVE = DriveSize(8.0, 192, 128)
_QUICK_RUN = {"steps": 40}
_QUICK_SCENE = {"cameras": ("front",), "iterations": 300}
_SCENE = {"scale": 1.0}


def resolve_bench(
    *,
    words: Sequence[str],
    track: str | None,
    motions: Sequence[str],
    quick: bool,
    config_file: Path | None,
    scene_config_file: Path | None,
    samples: int,
    drive_options: Mapping[str, Any],
    run_options: Mapping[str, Any],
    scene_options: Mapping[str, Any],
) -> BenchSettings:
    """Merge files and options; an option that is None was not given.

    Args:
        words, track: see `parse_scenes`.
        motions: names; none for the paper's.
        quick: small sizes where no option says otherwise.
        samples: number of bootstrap samples.

    Raises:
        InputError: a file, a scene or an option is wrong.
    """
    drive = replace(_QUICK_DRIVE if quick else DriveSize(), **given(drive_options))
    require_range(1, samples=samples)
    from_files = config_file is not None or scene_config_file is not None
    scene_defaults = {**({} if from_files else _SCENE), **(_QUICK_SCENE if quick else {})}
    run = resolve_config(
        ANY_TRACK,
        tuple(motions) or MOTIONS,
        config_file,
        scene_config_file,
        {**(_QUICK_RUN if quick else {}), **given(run_options)},
        {**scene_defaults, **given(scene_options)},
    )
    return BenchSettings(tuple(parse_scenes(words, run.seed, track)), run, drive, samples)


_ASKED = (
    *("scene", "world", "seed", "motion", "setting", "arm", "planner", "log", "track_id"),
    "steps_requested",
)
"""Members of a row that are known before it is run."""


@dataclass(frozen=True)
class GridRow:
    """A rollout of a grid of scenes, motions, settings and arms.

    Attributes:
        scene: its id in the grid.
        world, seed: world and seed of a synthetic scene, else None.
        log: name of the log; None where there is none.
        track_id: the controlled actor; None where the scene failed before it was known.
        motion, setting, arm, planner: the rollout's fields of the same names, see `Rollout`.
        start_timestamp_us, steps_requested, steps_run, cut_reason: fields of the same names, see
            `RolloutMetrics`; None where the rollout failed.
        plan_steps: steps at which plans were made; empty where the rollout failed.
        first_collision_step: step of the first collision; None where there was no collision.
        map_derived: field of the same name, see `RolloutMetrics`.
        scores: scores by metric, keys of `COLUMNS` and own ones, plain values (shares between 0
            and 1, seconds); None where a metric is not valid. Empty where the rollout failed.
        shorter: the same scores of the first steps alone, by how many steps: for each length at
            which the rollout of another arm in the scenario was cut.
        trust: how far to trust the verdict, see `RolloutTrust.to_json`; None for the truth, and
            where the rollout failed.
        failure: class of the error; None where the rollout was scored.
        failure_reason: its message.
    """

    scene: str
    world: str | None
    seed: int | None
    motion: str
    setting: str
    arm: str
    planner: str
    log: str | None = None
    track_id: str | None = None
    start_timestamp_us: int | None = None
    steps_requested: int | None = None
    steps_run: int | None = None
    cut_reason: str | None = None
    plan_steps: tuple[int, ...] = ()
    first_collision_step: int | None = None
    map_derived: bool | None = None
    scores: Mapping[str, float | None] = field(default_factory=dict)
    shorter: Mapping[int, Mapping[str, float | None]] = field(default_factory=dict)
    trust: Mapping[str, Any] | None = None
    failure: str | None = None
    failure_reason: str | None = None

    def of_log(self, log: str, track_id: str) -> GridRow:
        """This row with the log and the track it was run on."""
        return replace(self, log=log, track_id=track_id)

    def scored(self, metrics: Mapping[str, Any]) -> GridRow:
        """This row with an entry of metrics.json, see `recast.runs.scores`."""
        per_step = metrics["per_step"]
        return replace(
            self,
            start_timestamp_us=metrics["start_timestamp_us"],
            steps_requested=metrics["steps_requested"],
            steps_run=metrics["steps_run"],
            cut_reason=metrics["cut_reason"],
            plan_steps=tuple(metrics["per_cycle"]["plan_steps"]),
            first_collision_step=per_step["first_collision_step"],
            map_derived=per_step["map_derived"],
            scores={name: one["value"] for name, one in metrics["metrics"].items()},
            shorter={int(steps): scores for steps, scores in metrics["shorter"].items()},
            trust=metrics["trust"],
        )

    def over(self, steps: int) -> GridRow:
        """This row, had the rollout ended after `steps`: its own length, or one of `shorter`."""
        if steps == self.steps_run:
            return self
        return replace(
            self,
            steps_run=steps,
            scores=self.shorter[steps],
            shorter={},
            plan_steps=tuple(step for step in self.plan_steps if step < steps),
        )

    def failed(self, error: str, reason: str) -> GridRow:
        """This row without scores, and why."""
        asked = {name: getattr(self, name) for name in _ASKED}
        return GridRow(**asked, failure=error, failure_reason=reason)

    @property
    def plans(self) -> int:
        """How many plans were made."""
        return len(self.plan_steps)

    @property
    def values(self) -> Mapping[str, Metric]:
        """Every metric by name."""
        found = {**dict.fromkeys(COLUMNS), **self.scores}
        return {n: invalid("no value") if v is None else Metric(v) for n, v in found.items()}

    @property
    def collided(self) -> bool | None:
        """The verdict; None where the rollout failed."""
        nc = self.scores.get("nc")
        return None if nc is None else nc == 0.0

    @property
    def scenario(self) -> tuple[str, str, str, str]:
        """What rollouts have in common that differ in the arm only."""
        return self.scene, self.motion, self.setting, self.planner


@dataclass(frozen=True)
class ArmSummary:
    """An arm's line.

    Attributes:
        row: means, see `TableRow`.
        intervals: intervals by metric, in the column's unit, over scenes drawn whole; none where no
            rollout has a value.
    """

    row: TableRow
    intervals: Mapping[str, Bootstrap]


@dataclass(frozen=True)
class PairedDifference:
    """Candidate minus baseline of a metric, in the column's unit, on the scenarios of both.

    Attributes:
        candidate, baseline: arms.
        metric: key of `COLUMNS`.
        scenes, pairs: how many both have a value for.
        plans, cut, asked: see `recast.metrics.table.PairedMetric`.
        sampled: the bootstrap over scenes.
        exact: the same by enumeration; None where there are too many scenes.
    """

    planner: str
    candidate: str
    baseline: str
    metric: str
    scenes: int
    pairs: int
    plans: int
    cut: int
    asked: int
    sampled: Bootstrap
    exact: Bootstrap | None


def arm_summaries(rows: Sequence[GridRow], samples: int, seed: int) -> list[ArmSummary]:
    """The table: a line for each arm, in the order in which they first occur.

    Args:
        samples: number of bootstrap samples.
        seed: seed of the bootstrap; every interval sees the same draws.
    """
    # By its first row, whether that failed or not: the order is that of the grid.
    order = {key: i for i, key in enumerate(dict.fromkeys((r.planner, r.arm) for r in rows))}
    scored = [row for row in rows if row.failure is None]
    lines = table(scored, [row for row in rows if row.failure is not None])
    lines.sort(key=lambda line: order[line.planner, line.arm])
    summaries = []
    for line in lines:
        mine = [r for r in scored if (r.planner, r.arm) == (line.planner, line.arm)]
        intervals = {
            name: cluster_bootstrap(scenes, np.random.default_rng(seed), samples)
            for name in line.means
            if (scenes := _by_scene(mine, name))
        }
        summaries.append(ArmSummary(line, intervals))
    return summaries


def paired_summaries(
    rows: Sequence[GridRow], baseline: str, samples: int, seed: int
) -> list[PairedDifference]:
    """Every other arm against `baseline`, for every planner and metric that has a pair.

    Each pair is compared over the steps that both its rollouts have.

    Args:
        samples: number of bootstrap samples.
        seed: seed of the bootstrap; every interval sees the same draws.
    """
    found = []
    for planner in dict.fromkeys(row.planner for row in rows):
        mine = [row for row in rows if row.planner == planner]
        of_all = [row for row in mine if row.failure is None]
        scored: dict[str, list[GridRow]] = {}
        failed: dict[str, list[GridRow]] = {}
        for row in mine:
            (scored if row.failure is None else failed).setdefault(row.scene, []).append(row)
        for candidate in dict.fromkeys(row.arm for row in mine if row.arm != baseline):
            pairs = matched_pairs(scored, candidate, baseline, failed)
            for name, column in columns_of(of_all).items():
                one = pairs.of(name)
                if one.pairs == 0:
                    continue
                values = [column.scale * scene for scene in one.differences.values()]
                counts = (len(values), one.pairs, one.plans, one.cut, one.asked)
                sampled = cluster_bootstrap(values, np.random.default_rng(seed), samples)
                exact = exact_bootstrap(values) if len(values) <= MOST_EXACT else None
                who = (planner, candidate, baseline, name)
                found.append(PairedDifference(*who, *counts, sampled, exact))
    return found


def _by_scene(rows: Sequence[GridRow], name: str) -> list[Array]:
    scenes: dict[str, list[float]] = {}
    for row in rows:
        value = row.scores.get(name)
        if value is not None:
            scenes.setdefault(row.scene, []).append(column_of(name).scale * value)
    return [np.array(values) for values in scenes.values()]
