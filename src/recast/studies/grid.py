"""What a grid is asked to be, on the command line and in a file, and its record in its folder."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Self

from recast.core import files, folder_hash
from recast.core.errors import InputError, require_range
from recast.core.names import folder_name
from recast.logs import read_log
from recast.metrics.pairs import SAMPLES
from recast.runs.config import RunConfig, given, resolve_config
from recast.runs.paper import AUTO_TRACK, choose_target
from recast.runs.run_folder import claim_empty, first_difference
from recast.synthetic import SCENES

ALL_SYNTHETIC = "synthetic"
"""The word for every synthetic scene."""
RECORD_FILE, ROLLOUTS_FILE, RESULTS_FILE = "bench.json", "rollouts.parquet", "results.json"
TIMES_FILE, SCENES_FOLDER = "times.json", "scenes"
BENCH_FORMAT, BENCH_VERSION = "recast-closed-loop", 2
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
    if track not in log.tracks:
        raise InputError(
            path, f"track {track}", "is not in the log", f"choose one of {', '.join(log.tracks)}"
        )
    return BenchScene(folder_name(f"{log.name}-{track}"), log=path, track=track)


@dataclass(frozen=True)
class DriveSize:
    """Of the synthetic scenes: seconds of the drive, and pixels of its images."""

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


def begin(out: Path, record: Mapping[str, Any]) -> None:
    """Take `out` for the grid of this record, or go on with it there.

    Raises:
        InputError: it holds something else; nothing is written then.
    """
    path = out / RECORD_FILE
    if path.is_file():
        found = files.read_json(path)
        if not isinstance(found, dict) or found.get("format") != record["format"]:
            raise InputError(path, "format", "is not that of a grid", "give another `out`")
        differing = first_difference({name: found.get(name) for name in record}, dict(record))
        if differing is not None:
            raise InputError(
                path,
                differing,
                "differs: the folder contains another grid",
                "give another `out`, or repeat the options of the grid in this folder",
            )
        return
    claim_empty(out, RECORD_FILE)
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
