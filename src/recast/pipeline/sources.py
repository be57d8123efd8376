"""What makes the steps of a run: recipes and exchangeable parts, for their fingerprints."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Self

from recast.actors import DEFAULT_GENERATOR, GENERATORS, SEGMENTERS, is_segmenter_folder
from recast.actors.library import LIBRARY
from recast.actors.vehicle_files import files_of_vehicle, is_vehicle_file
from recast.pipeline.config import RunConfig
from recast.pipeline.fingerprint import file_hash, files_hash, folder_hash
from recast.planning import PLANNERS, planner_folder, planner_source_files
from recast.plugins import Registry
from recast.trellis import RECAST_MINI, recast_mini

RECIPES = {
    "actor": 4,
    "refine": 2,
    "scene": 1,
    "evaluation": 1,
    "truth": 2,
    "rollout": 2,
    "metrics": 2,
    "report": 2,
}
"""Version of what recast's own code makes of the inputs of a step.

Raise a step's number in the commit that changes what the step writes for the same inputs; runs that
lie there then make it, and all that follows from it, again.
"""


@dataclass(frozen=True)
class Sources:
    """What stands for the exchangeable parts of a run in fingerprints.

    A built-in part is its name, since `RECIPES` count its changes; a file or a folder is its
    content; other code is its name with the content of its files.
    """

    planner: str
    generator: str
    segmenter: str

    @classmethod
    def of(cls, config: RunConfig) -> Self:
        """Those of a configuration; call it before anything of them is loaded.

        So a part that is edited meanwhile counts as the older one, and is used again next time.

        Raises:
            InputError: a name is unknown.
        """
        return cls(
            planner_source(config.planner),
            generator_source(config.generator),
            segmenter_source(config.segmenter),
        )


def planner_source(name: str) -> str:
    """What stands for a planner; see `Sources`."""
    folder = planner_folder(name)
    if folder is not None:
        return folder_hash(folder)
    return _code(PLANNERS, name, planner_source_files(name))


def generator_source(name: str) -> str:
    """What stands for a generator; see `Sources`. Vehicles' files must be there."""
    if name.startswith(LIBRARY):
        return folder_hash(name.removeprefix(LIBRARY))
    if is_vehicle_file(name):
        first, *others = files_of_vehicle(Path(name))
        return files_hash([first, *others], first.parent) if others else file_hash(first)
    if name == RECAST_MINI:
        return folder_hash(recast_mini())
    if name == DEFAULT_GENERATOR:  # offers the template and that model
        return f"{name} {folder_hash(recast_mini())}"
    if Path(name).is_dir():
        return folder_hash(name)
    return _code(GENERATORS, name, GENERATORS.source_files(name))


def segmenter_source(name: str) -> str:
    """What stands for a segmenter; see `Sources`."""
    if is_segmenter_folder(name):
        return folder_hash(name)
    return _code(SEGMENTERS, name, SEGMENTERS.source_files(name))


def _code(registry: Registry, name: str, files: tuple[Path, ...]) -> str:
    if not files:
        return name
    # Names below the folder that all share: the same code elsewhere is the same code.
    root = Path(os.path.commonpath([file.parent for file in files]))
    plugins = entry_points(group=registry.group)
    package = plugins[name].dist if name in plugins.names else None
    # Its data files are not looked at, so the version stands for them.
    return " ".join([name, *([package.version] if package else []), files_hash(files, root)])
