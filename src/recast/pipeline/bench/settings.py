"""What a grid is asked to be, and the record of it in its folder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Self

from recast import storage
from recast.core import folder_hash
from recast.errors import InputError
from recast.evaluation.bootstrap import SAMPLES
from recast.pipeline.bench.scenes import BenchScene
from recast.pipeline.config import RunConfig
from recast.pipeline.run_folder import claim_empty

RECORD_FILE, ROLLOUTS_FILE, RESULTS_FILE = "bench.json", "rollouts.parquet", "results.json"
TIMES_FILE, SCENES_FOLDER = "times.json", "scenes"
BENCH_FORMAT, BENCH_VERSION = "recast-closed-loop", 2

ANY_TRACK = "*"
"""Stands in `BenchSettings.run` for the track, which every scene has its own of."""


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
        scenes: at least one.
        run: motions, arms (the first is the baseline), planners and all else, the same for every
            scene; its track is `ANY_TRACK`.
        drive: size of synthetic scenes.
        samples: of the bootstrap.
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

        The member `config` is the configuration of a run, so that `--config` reads it.
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
        found = storage.read_json(path)
        if not isinstance(found, dict) or found.get("format") != record["format"]:
            raise InputError(path, "format", "is no grid's", "name another --out")
        for name, value in json.loads(json.dumps(record)).items():
            if found.get(name) != value:
                raise InputError(
                    path, _where(name, found.get(name), value), "differs: another grid lies there",
                    "name another --out, or repeat the options of the grid that lies there",
                )  # fmt: skip
        return
    claim_empty(out, RECORD_FILE)
    storage.write_json(path, record)


def _where(name: str, found: Any, wanted: Any) -> str:
    """Dotted name of the first member that differs."""
    if isinstance(found, Mapping) and isinstance(wanted, Mapping):
        for key in wanted:
            if found.get(key) != wanted[key]:
                return _where(f"{name}.{key}", found.get(key), wanted[key])
    return name


def _scene_record(scene: BenchScene) -> dict[str, Any]:
    if scene.log is None:
        return {"id": scene.id, "world": scene.world, "seed": scene.seed}
    return {"id": scene.id, "log": folder_hash(scene.log), "track": scene.track}
