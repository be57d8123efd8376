"""log.json: what a log holds beyond its NCore store, one small versioned text file.

NCore keeps intrinsics as float32 and has no place for the name, the world offset and the licence.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import field_validator

from recast import records, storage
from recast.geometry import PinholeCamera

VERSION = 1


class CameraRecord(records.Record):
    """Exact intrinsics of one camera; pixels, pixel centres at +0.5."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]

    @classmethod
    def of(cls, camera: PinholeCamera) -> CameraRecord:
        """Record `camera`."""
        return cls(
            width=camera.width,
            height=camera.height,
            fx=camera.fx,
            fy=camera.fy,
            cx=camera.cx,
            cy=camera.cy,
            distortion=camera.distortion,
        )

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
            raise ValueError("a name stands there twice")
        return names


def write_record(record: LogRecord, path: Path) -> None:
    """Write log.json, whole or not at all."""
    storage.write_json(path, record.model_dump())


def read_record(path: Path) -> LogRecord:
    """Read log.json.

    Raises:
        InputError: missing, not a log.json, of another version, or a field of the wrong kind.
    """
    return records.read_record(
        path, LogRecord, VERSION, "name a folder that import wrote, or import again", "recast-log"
    )
