"""A log on disk: a folder with an NCore V4 store, log.json and, if there is a map, map.json."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import field_validator

from recast.cameras import PinholeCamera
from recast.core import files, records
from recast.core.arguments import checked
from recast.core.errors import InputError
from recast.core.progress import Progress
from recast.logs import ncore_read
from recast.logs.checks import refused
from recast.logs.map_json import read_map, write_map
from recast.logs.ncore_folder import NcoreFolder
from recast.logs.ncore_write import write_ncore
from recast.logs.plausibility import require_plausible
from recast.logs.types import DrivingLog

VERSION = 1
LOG_FILE = "log.json"
MAP_FILE = "map.json"

WriteProgress = Progress
"""Called with the images and sweeps written so far, and with all there are."""


@checked()
def write_log(log: DrivingLog, path: str | Path, progress: WriteProgress | None = None) -> None:
    """Write `log` to the new folder `path`; it appears whole or not at all.

    One image or sweep at a time is in memory. Images that are PNG or JPEG files already keep their
    bytes, others become PNG. LiDAR points are stored as NCore wants them: rays in the sensor frame,
    as measured.

    Args:
        log: images and sweeps are read from their source now; its `origin` is not written.
        path: the folder; the one above it is made if it is missing.
        progress: called after each image or sweep, and once before the first.

    Raises:
        InputError: the log is not valid, no vehicle can have recorded it, one of its images or
            sweeps cannot be read, `path` exists, or the disk refuses.
    """
    require_plausible(log, f"log {log.name}", "correct the data from which the log was made")
    with files.atomic_folder(path) as folder:
        write_ncore(log, folder, progress or (lambda done, total: None))
        if log.map is not None:
            write_map(log.map, folder / MAP_FILE)
        x, y, z = (float(value) for value in log.world_offset)
        record = LogRecord(
            name=log.name,
            world_offset=(x, y, z),
            metadata=dict(log.metadata),
            cameras={name: CameraRecord(**asdict(c.camera)) for name, c in log.cameras.items()},
            lidars=list(log.lidars),
            has_map=log.map is not None,
        )
        files.write_json(folder / LOG_FILE, record.model_dump())


def read_log(path: str | Path) -> DrivingLog:
    """Read a log folder; images and sweeps are decoded when asked for.

    Returns:
        the log, with the folder's absolute path as its `origin`.

    Raises:
        InputError: no such folder, not a log, another version, a file of it missing or broken, or
            no vehicle can have recorded it (`recast.logs.plausibility`).
    """
    folder = Path(path).absolute()
    if not folder.is_dir():
        raise InputError(path, "log folder", "does not exist", "import a drive: recast log import")
    if not (folder / LOG_FILE).is_file():
        raise InputError(path, LOG_FILE, "is missing", "name a folder that recast log import wrote")
    record = records.read_record(
        folder / LOG_FILE,
        LogRecord,
        VERSION,
        "name a folder that recast log import wrote, or import again",
        "recast-log",
    )
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
    require_plausible(log, path, "import the drive again")
    object.__setattr__(log, "origin", folder)  # no argument, so that `replace` drops it
    return log


class CameraRecord(records.Record):
    """Exact intrinsics of one camera; pixels, pixel centres at +0.5."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]

    def camera(self) -> PinholeCamera:
        """The camera recorded."""
        return PinholeCamera(**self.model_dump())


class LogRecord(records.Record):
    """The contents of log.json."""

    format: Literal["recast-log"] = "recast-log"
    version: Literal[1] = 1
    name: str
    world_offset: tuple[float, float, float]
    metadata: dict[str, str]
    cameras: dict[str, CameraRecord]
    lidars: list[str]
    has_map: bool

    @field_validator("lidars")
    @classmethod
    def _different(cls, names: list[str]) -> list[str]:
        if len(set(names)) != len(names):
            raise ValueError("a name appears twice")
        return names
