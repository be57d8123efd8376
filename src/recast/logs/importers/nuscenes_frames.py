"""Which images and sweeps a nuScenes scene has, sensor by sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from recast.errors import InputError
from recast.logs.importers.nuscenes_tables import (
    CalibratedSensorRow,
    SampleDataRow,
    SampleRow,
    SensorRow,
    linked,
    select,
)
from recast.names import member


@dataclass(frozen=True)
class Sensor:
    """A camera or LiDAR of a scene.

    Attributes:
        kind: "camera" or "lidar".
        frames: in the order of time.
    """

    name: str
    kind: str
    mount: CalibratedSensorRow
    frames: list[SampleDataRow]


def read_sensors(
    root: Path, tables: Path, samples: Sequence[SampleRow], cameras: Sequence[str] = ()
) -> list[Sensor]:
    """Cameras and LiDARs of the scene whose key frames are `samples`, by name; no radars.

    Where the dataset's folder `root` has no folder sweeps, frames between key frames are left out.
    Only the files of LiDARs and of the `cameras` wanted (all if empty) must be there.

    Raises:
        InputError: a table, column or file is missing, a token leads nowhere, a sensor has two
            calibrations or two frames of one time.
    """
    path = tables / "sample_data.json"
    frames = select(path, SampleDataRow, "sample_token", {sample.token for sample in samples})
    if not (root / "sweeps").is_dir():
        frames = [frame for frame in frames if frame.is_key_frame]
    mounts = linked(
        tables,
        "calibrated_sensor",
        CalibratedSensorRow,
        frames,
        "sample_data",
        "calibrated_sensor_token",
    )
    kinds = linked(
        tables, "sensor", SensorRow, list(mounts.values()), "calibrated_sensor", "sensor_token"
    )
    sensors: dict[str, Sensor] = {}
    for frame in sorted(frames, key=lambda frame: frame.timestamp):
        mount = mounts[frame.calibrated_sensor_token]
        kind = kinds[mount.sensor_token]
        if kind.modality not in ("camera", "lidar"):  # radar
            continue
        sensor = sensors.setdefault(kind.channel, Sensor(kind.channel, kind.modality, mount, []))
        _check_frame(path, frame, sensor)
        if sensor.kind == "lidar" or not cameras or sensor.name in cameras:
            _check_file(root, path, frame)
        sensor.frames.append(frame)
    return [sensors[name] for name in sorted(sensors)]


def _check_frame(path: Path, frame: SampleDataRow, sensor: Sensor) -> None:
    def refuse(column: str, problem: str, mend: str) -> InputError:
        return InputError(path, f"token {frame.token}: {column}", problem, mend)

    if frame.calibrated_sensor_token != sensor.mount.token:
        problem = f"{sensor.name} has a second calibration within the scene"
        raise refuse("calibrated_sensor_token", problem, "use tables as published")
    if sensor.frames and frame.timestamp == sensor.frames[-1].timestamp:
        problem = f"{frame.timestamp} is there twice for {sensor.name}"
        raise refuse("timestamp", problem, "use tables as published")
    formats = ("jpg", "jpeg", "png") if sensor.kind == "camera" else ("pcd", "bin")
    if frame.fileformat not in formats:
        problem = f"is {frame.fileformat!r}, not {' or '.join(formats)}"
        raise refuse("fileformat", problem, "use files as published")


def _check_file(root: Path, path: Path, frame: SampleDataRow) -> None:
    field = f"token {frame.token}: filename"
    if not member(root, frame.filename, path, field).is_file():
        problem = f"{frame.filename} is missing under {root}"
        raise InputError(path, field, problem, "unpack the file archives of this scene")
