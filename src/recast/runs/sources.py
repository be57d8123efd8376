"""What a run is made from: its log, the recipes and parts of its steps, for keys of artefacts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Self

from rich.console import Console

from recast.actors import DEFAULT_GENERATOR, GENERATORS, SEGMENTERS
from recast.actors.library import LIBRARY
from recast.actors.parametric import PARAMETRIC, ParametricGenerator
from recast.actors.vehicle_files import files_of_vehicle, is_vehicle_file
from recast.core.artefact import file_hash, files_hash, folder_hash, remote_path
from recast.core.diagnostics import ProgressBar
from recast.core.errors import InputError
from recast.core.plugins import METRICS, RESTORERS
from recast.logs import DrivingLog, HdMap, map_of, read_log
from recast.logs.load import local_folder
from recast.planning import planner_source
from recast.pretrained import VQA_SCORERS
from recast.runs.config import RunConfig
from recast.synthetic import CAMERAS, World, drive_of, synthesize_log, world_of
from recast.synthetic.rendering import require_embree
from recast.trellis import RECAST_MINI, recast_mini
from recast.weights import shipped_folder

RECIPES = {
    "log": 2,
    "actor": 11,
    "refine": 7,
    "turntable": 1,
    "scene": 8,
    "evaluation": 4,
    "truth": 5,
    "rollout": 12,
    "plans": 3,
    "scene-level": 3,
    "metrics": 13,
    "report": 18,
}
"""Version of what recast's own code makes of the inputs of a step.

Raise a step's number in the commit that changes what the step writes for the same inputs: it is
then another artefact, and so is all that follows from it. tests/runs/test_recipes.py fails when the
code of a step changes and its number does not.
"""


@dataclass(frozen=True)
class SourceLog:
    """A log folder, opened.

    Attributes:
        address: address of the log, if that is another place than the folder, which holds a copy.
        made_from: gives the world of a synthetic log, where it is at hand.
    """

    path: Path
    log: DrivingLog
    hash: str
    address: str | None = None
    made_from: Callable[[], World] | None = None

    @classmethod
    def open(cls, place: str | Path, world: Callable[[], World] | None = None) -> SourceLog:
        """Read a log folder, here or in object storage; InputError: see `load_log`.

        Args:
            world: gives what a synthetic log was made from, if it is at hand.
        """
        path = local_folder(place)
        remote = remote_path(place) is not None
        address = str(place) if remote else None
        return cls(path, read_log(path), folder_hash(path), address, world)

    @cached_property
    def map(self) -> HdMap:
        """The log's map, or one derived from the drive."""
        return map_of(self.log)

    @cached_property
    def world(self) -> World:
        """What a synthetic log was made from.

        Raises:
            InputError: it is a recorded log, or no ray tracer is installed.
        """
        self.require_world()
        return world_of(self.log) if self.made_from is None else self.made_from()

    def require_world(self) -> None:
        """Refuse what `world` would refuse, without making it.

        Raises:
            InputError: it is a recorded log, or no ray tracer is installed.
        """
        require_embree()
        drive_of(self.log)


def require_track(log: DrivingLog, path: Path, track: str) -> None:
    """Refuse a track that a log folder lacks.

    Raises:
        InputError: lists the tracks that it has.
    """
    if track not in log.tracks:
        mend = f"choose one of {', '.join(log.tracks)}"
        raise InputError(path, f"track {track}", "is not in the log", mend)


def drive_log(
    world: Callable[[], World],
    metadata: Mapping[str, str],
    path: Path,
    image_size: tuple[int, int],
    cameras: tuple[str, ...],
    workers: int,
    console: Console,
    every: int = 1,
) -> Path:
    """The log of a world at `path`, its images of width and height pixels.

    Args:
        world: gives the world, if the log is not there yet.
        metadata: what the log says of the world.
        cameras: names of the cameras that are recorded; none named: all of the rig.
        every: see `synthesize_log`.

    Raises:
        InputError: another log lies there, or see `synthesize_log`.
    """
    seconds = float(metadata["seconds"])
    console.print(f"[bold]log[/bold] {metadata['scene']}, {seconds:g} s", highlight=False)
    names = cameras or CAMERAS
    if path.exists():
        _check_same(read_log(path), metadata, image_size, names, path)
        console.print("  exists already")
        return path
    width, height = image_size
    with ProgressBar("images", console, round(seconds * 10 / every) * len(names)) as progress:
        synthesize_log(
            world(),
            path,
            width=width,
            height=height,
            cameras=names,
            workers=workers,
            every=every,
            progress=progress,
        )
    return path


def _check_same(
    log: DrivingLog,
    wanted: Mapping[str, str],
    image_size: tuple[int, int],
    names: tuple[str, ...],
    path: Path,
) -> None:
    shape = {name: (c.camera.width, c.camera.height) for name, c in log.cameras.items()}
    same = all(log.metadata.get(name) == value for name, value in wanted.items())
    if not same or shape != dict.fromkeys(names, image_size):
        raise InputError(
            path, "log", "is of another drive", "name another `out`, or remove this folder"
        )


@dataclass(frozen=True)
class Sources:
    """What stands for the exchangeable parts of a run in keys.

    A built-in part is its name, since `RECIPES` count its changes; a file or a folder is its
    content; other code is its name with the content of its files.
    """

    planners: Mapping[str, str]
    generators: Mapping[str, str]
    segmenters: Mapping[str, str]
    restorers: Mapping[str, str] = field(default_factory=dict)
    metrics: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, config: RunConfig, scene: str, known: Sources | None = None) -> Self:
        """Those of a configuration, by name; call it before anything of them is loaded.

        So a part that is edited meanwhile counts as the older one, and is used again next time.

        Args:
            scene: name of the scene, for generators that have a file for each.
            known: sources of another scene of the same process; the parts among them may be loaded.

        Raises:
            InputError: a name is unknown.
        """
        known = known or Sources({}, {}, {})
        arms = [config.arm(arm.name).of_scene(scene) for arm in config.arms]
        generated = [arm for arm in arms if arm.generates]
        restorers = () if config.restorer is None else (config.restorer,)
        return cls(
            _each(config.planners, planner_source, known.planners),
            _each([str(arm.generator) for arm in generated], generator_source, known.generators),
            _each([str(arm.segmenter) for arm in generated], segmenter_source, known.segmenters),
            _each(restorers, restorer_source, known.restorers),
            _each(config.metrics, METRICS.source, known.metrics),
        )


def _each(
    names: Iterable[str], source: Callable[[str], str], known: Mapping[str, str]
) -> dict[str, str]:
    return {name: known[name] if name in known else source(name) for name in names}


def generator_source(name: str) -> str:
    """What stands for a generator; see `Sources`. Vehicles' files must be there."""
    if name.startswith(LIBRARY):
        return folder_hash(name.removeprefix(LIBRARY))
    if is_vehicle_file(name):
        first, *others = files_of_vehicle(Path(name))
        return files_hash([first, *others], first.parent) if others else file_hash(first)
    if name == RECAST_MINI:
        return folder_hash(recast_mini())
    if name in (ParametricGenerator.name, DEFAULT_GENERATOR):  # the latter offers it, too
        return f"{name} {folder_hash(shipped_folder(PARAMETRIC))}"
    return GENERATORS.source(name)


def segmenter_source(name: str) -> str:
    """What stands for a segmenter; see `Sources`."""
    return SEGMENTERS.source(name)


def restorer_source(name: str) -> str:
    """What stands for a restorer; see `Sources`. Of another program only its address is known."""
    return RESTORERS.source(name)


def vqa_source(name: str) -> str:
    """What stands for a VQA scorer; see `Sources`."""
    return VQA_SCORERS.source(name)
