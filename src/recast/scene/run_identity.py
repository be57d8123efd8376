"""Which run a scene folder belongs to: its configuration and its log."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from recast.errors import InputError
from recast.logs import DrivingLog
from recast.records import Record
from recast.scene.config import SceneConfig, parse_config, write_config
from recast.storage import partial_name, read_json, write_json

CONFIG_FILE = "config.json"
SOURCE_FILE = "source.json"
FREE_FIELDS = frozenset({"threads", "evaluate_every", "checkpoint_every"})
"""Fields that may differ when a run is taken up again: they do not change what is learned."""


class Source(Record):
    """Contents of source.json: the log a scene is made from."""

    log_name: str
    log_fingerprint: str


def log_fingerprint(log: DrivingLog) -> str:
    """SHA-256 over everything of a log but images and points, in hexadecimal.

    Times, poses, intrinsics and boxes tell drives and imports apart; hashing all pixels would take
    longer than starting over.
    """
    digest = hashlib.sha256(log.name.encode())

    def add(name: str, *arrays: object) -> None:
        digest.update(name.encode())
        for array in arrays:
            digest.update(np.ascontiguousarray(array).tobytes())

    add("ego", log.world_from_rig.timestamps_us, log.world_from_rig.poses, log.world_offset)
    for name, camera in log.cameras.items():
        intrinsics = camera.camera
        add(name, camera.timestamps_us, camera.rig_from_camera, intrinsics.matrix)
        add("image", [intrinsics.width, intrinsics.height], intrinsics.distortion)
    for name, lidar in log.lidars.items():
        add(name, lidar.timestamps_us, lidar.rig_from_lidar)
    for name, track in log.tracks.items():
        add(name, track.size, track.trajectory.timestamps_us, track.trajectory.poses)
    return digest.hexdigest()


def claim_folder(folder: Path, log: DrivingLog, config: SceneConfig) -> None:
    """Make `folder` this run's, or check that it is already.

    Raises:
        InputError: it holds something else, or a run with another log, configuration or version.
    """
    source = Source(log_name=log.name, log_fingerprint=log_fingerprint(log))
    if folder.exists() and not folder.is_dir():
        raise InputError(folder, "output folder", "is a file", "name another one")
    if (folder / CONFIG_FILE).is_file() and (folder / SOURCE_FILE).is_file():
        _check_same(folder, source, config)
        return
    strangers = [] if not folder.exists() else sorted(folder.iterdir())
    begun = {
        partial_name(name).name for name in (CONFIG_FILE, SOURCE_FILE)
    }  # left behind by a kill
    ours = {CONFIG_FILE, SOURCE_FILE, *begun}
    strangers = [path for path in strangers if path.name not in ours]
    if strangers:
        raise InputError(
            folder,
            "output folder",
            f"holds something that is no scene ({strangers[0].name})",
            "name another one or remove it",
        )
    write_json(folder / SOURCE_FILE, source.model_dump())
    write_config(config, folder / CONFIG_FILE)


def read_training_config(folder: str | Path) -> SceneConfig:
    """The configuration that a scene folder was trained with.

    Raises:
        InputError: missing, broken or of another version.
    """
    path = Path(folder) / CONFIG_FILE
    return parse_config(path, read_json(path))


def _check_same(folder: Path, source: Source, config: SceneConfig) -> None:
    mend = "name another folder or remove this one"
    found = read_training_config(folder)
    if not found.is_whole():
        problem = "are those of an earlier release, whose recipe was another"
        raise InputError(folder / CONFIG_FILE, "fields", problem, mend)
    for name in SceneConfig.model_fields:
        before, asked = getattr(found, name), getattr(config, name)
        if name not in FREE_FIELDS and before != asked:
            raise InputError(
                folder, name, f"holds a run with {before!r}, this one has {asked!r}", mend
            )
    try:
        before = Source.model_validate(read_json(folder / SOURCE_FILE))
    except ValidationError:
        raise InputError(folder / SOURCE_FILE, "source", "cannot be read", mend) from None
    if before != source:
        raise InputError(
            folder,
            "log",
            f"holds a run of {before.log_name}"
            + (" in another state" if before.log_name == source.log_name else ""),
            mend,
        )
