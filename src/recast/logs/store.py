"""A log on disk: a folder with an NCore V4 store, log.json and, where there is a map, map.json."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

import numpy as np

from recast import storage
from recast.errors import InputError
from recast.logs import ncore_read
from recast.logs.checks import refused
from recast.logs.log_json import CameraRecord, LogRecord, read_record, write_record
from recast.logs.map_json import read_map, write_map
from recast.logs.ncore_folder import NcoreFolder
from recast.logs.ncore_write import write_ncore
from recast.logs.types import DrivingLog

LOG_FILE = "log.json"
MAP_FILE = "map.json"

WriteProgress = Callable[[int, int], None]
"""Called with the images and sweeps written so far, and with all there are."""


def _unwatched(done: int, total: int) -> None:
    pass


_watcher: ContextVar[WriteProgress] = ContextVar("_watcher", default=_unwatched)


@contextmanager
def watch_writing(progress: WriteProgress) -> Iterator[None]:
    """Have `progress` called by the `write_log` calls within the block.

    It is no argument of `write_log`, so that importers, which end with it, need not hand it on.
    """
    token = _watcher.set(progress)
    try:
        yield
    finally:
        _watcher.reset(token)


def write_log(log: DrivingLog, path: str | Path) -> None:
    """Write `log` to the new folder `path`; it appears whole or not at all.

    One image or sweep at a time is in memory. Images that are PNG or JPEG files already keep their
    bytes, others become PNG. LiDAR points are stored as NCore wants them: rays in the sensor frame,
    as measured.

    Raises:
        InputError: the log is not valid, `path` exists, or the disk refuses.
    """
    with refused(f"log {log.name}", "correct the data that the log was made of"):
        log.validate()
    with storage.atomic_folder(path) as folder:
        write_ncore(log, folder, _watcher.get())
        if log.map is not None:
            write_map(log.map, folder / MAP_FILE)
        x, y, z = (float(value) for value in log.world_offset)
        record = LogRecord(
            name=log.name,
            world_offset=(x, y, z),
            metadata=dict(log.metadata),
            cameras={name: CameraRecord.of(c.camera) for name, c in log.cameras.items()},
            lidars=list(log.lidars),
            has_map=log.map is not None,
        )
        write_record(record, folder / LOG_FILE)


def read_log(path: str | Path) -> DrivingLog:
    """Read a log folder; images and sweeps are decoded when asked for.

    Raises:
        InputError: no such folder, not a log, another version, or a file of it missing or broken.
    """
    folder = Path(path).absolute()
    if not folder.is_dir():
        raise InputError(path, "log folder", "does not exist", "import a drive: recast log import")
    if not (folder / LOG_FILE).is_file():
        raise InputError(path, LOG_FILE, "is missing", "name a folder that recast log import wrote")
    record = read_record(folder / LOG_FILE)
    store = NcoreFolder(folder)
    store.check()
    world_from_rig = ncore_read.read_trajectory(store)
    cameras = {}
    for name, camera in record.cameras.items():
        with refused(folder / LOG_FILE, "import the drive again"):
            camera.camera().validate()  # before images and masks are as large as it says
        cameras[name] = ncore_read.read_camera(store, name, camera.camera())
    log = DrivingLog(
        name=record.name,
        cameras=cameras,
        lidars={n: ncore_read.read_lidar(store, n, world_from_rig) for n in record.lidars},
        world_from_rig=world_from_rig,
        tracks=ncore_read.read_tracks(store),
        map=read_map(folder / MAP_FILE) if record.has_map else None,
        world_offset=np.array(record.world_offset, np.float64),
        metadata=record.metadata,
    )
    with refused(path, "import the drive again"):
        log.validate()
    return log
