"""Tables of Waymo v2: one parquet file for each component of a segment, checked as they are read.

A file lies at COMPONENT/SEGMENT.parquet. Columns are named `key.NAME` (what the row is of) and
`[Component].field`. What holds for a whole segment is here too: calibrations, when and where.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from recast.core.errors import InputError
from recast.core.table_files import ROW_LIMIT, ParquetRows
from recast.logs.importers.common import check_drive, unknown_drive
from recast.logs.importers.waymo_proto import (
    CAMERA_NAME,
    LASER_NAME,
    ROLLING_SHUTTER,
    FieldError,
    ProtoEnum,
)
from recast.logs.importers.waymo_segment import MEND, LaserCalibration, Place, WaymoCamera
from recast.logs.importers.waymo_values import camera_calibration, laser_calibration, rigid
from recast.logs.types import Array

SEGMENT, TIME = "key.segment_context_name", "key.frame_timestamp_micros"
COMPONENTS = {
    "vehicle_pose": "VehiclePoseComponent",
    "camera_calibration": "CameraCalibrationComponent",
    "camera_image": "CameraImageComponent",
    "lidar_calibration": "LiDARCalibrationComponent",
    "lidar": "LiDARComponent",
    "lidar_pose": "LiDARPoseComponent",
    "lidar_box": "LiDARBoxComponent",
    "stats": "StatsComponent",
}
"""Folders that are read, and the name of the component in the names of its columns."""
CAMERA, LASER = "key.camera_name", "key.laser_name"
_INTRINSIC = [f"intrinsic.{n}" for n in ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")]
_BEAMS = "beam_inclination"
_STATS = ["time_of_day", "location", "weather"]


@dataclass(frozen=True)
class WaymoRow:
    """A row of a table; its values are checked when asked for, and raise FieldError.

    Attributes:
        table: table that has the row.
        index: index of the row, counted from 0.
        values: values by column.
    """

    table: WaymoTable
    index: int
    values: Mapping[str, Any]

    @property
    def place(self) -> Place:
        """The file and the number of the row."""
        return Place(self.table.path, f"row {self.index}")

    def column(self, field: str) -> str:
        """The column of a field."""
        return self.table.column(field)

    def integer(self, field: str) -> int:
        """An integer."""
        return self._present(field, int, "an integer")

    def number(self, field: str) -> float:
        """A number; it may be infinite or none."""
        return float(self._present(field, (int, float), "a number"))

    def text(self, field: str) -> str:
        """A text."""
        return self._present(field, str, "text")

    def choice(self, field: str, choice: ProtoEnum) -> str:
        """The name of an enumeration's value: some files hold the number, some the name itself."""
        value = self._present(field)
        if isinstance(value, str) and value in choice.names.values():
            return value
        if not isinstance(value, int):
            raise FieldError(self.column(field), f"is {value!r}, not a {choice.name}")
        return choice.of(value, self.column(field))

    def numbers(self, field: str) -> Array:
        """A list of numbers (N,); empty if the cell is."""
        value = self.values[self.column(field)]
        value = [] if value is None else value
        if not isinstance(value, list) or not all(isinstance(one, (int, float)) for one in value):
            raise FieldError(self.column(field), "is not a list of numbers")
        return np.array(value, np.float64)

    def pose(self, field: str) -> Array:
        """A (4, 4) pose in the field `field`.transform."""
        self._present(f"{field}.transform")
        return rigid(self.numbers(f"{field}.transform"), self.column(f"{field}.transform"))

    def _present(
        self, field: str, kind: type | tuple[type, ...] = object, called: str = "a value"
    ) -> Any:
        value = self.values[self.column(field)]
        if value is None:
            raise FieldError(self.column(field), "is empty")
        if not isinstance(value, kind):
            raise FieldError(self.column(field), f"is {value!r}, not {called}")
        return value


@dataclass(frozen=True)
class WaymoTable:
    """One component of a segment.

    Attributes:
        path: its file, named after the segment.
        component: name of the component, as in the names of its columns.
    """

    path: Path
    component: str

    def column(self, field: str) -> str:
        """The column of a field; keys are columns already."""
        return field if field.startswith("key.") else f"[{self.component}].{field}"

    def rows(self, fields: Sequence[str]) -> Iterator[WaymoRow]:
        """All rows with the keys (`key.NAME`) and fields asked for, a thousand in memory at once.

        Raises:
            InputError: the file is none, lacks a column, or has rows of another segment.
        """
        columns = [SEGMENT, *(self.column(field) for field in fields)]
        file = ParquetRows(self.path, columns, MEND)
        if file.first_rows[-1] > ROW_LIMIT:
            problem = f"there are {file.first_rows[-1]}, more than {ROW_LIMIT}"
            raise Place(self.path, "rows").error(problem)
        index = 0
        for group in range(len(file.first_rows) - 1):
            for batch in file.batches(group):
                for values in batch.to_pylist():
                    row = WaymoRow(self, index, values)
                    self._check_segment(row)
                    yield row
                    index += 1

    def _check_segment(self, row: WaymoRow) -> None:
        with row.place.errors():
            name = row.text(SEGMENT)
            if name != self.path.stem:
                raise FieldError(
                    SEGMENT, f"is {name!r}, but the file is of segment {self.path.stem!r}"
                )


@dataclass(frozen=True)
class Components:
    """The files of a segment: `folder`/COMPONENT/`segment`.parquet."""

    folder: Path
    segment: str

    def has(self, name: str) -> bool:
        """Whether a component was downloaded: people take only those they need."""
        return (self.folder / name).is_dir()

    def table(self, name: str) -> WaymoTable:
        """The table of a component.

        Raises:
            InputError: it is missing.
        """
        path = self.folder / name / f"{self.segment}.parquet"
        if not path.is_file():
            raise InputError(path, "file", "is missing", f"download the component {name}")
        return WaymoTable(path, COMPONENTS[name])

    def left_out(self) -> list[str]:
        """Components that are not there."""
        return [name for name in COMPONENTS if not self.has(name)]


def find_segment(root: Path, drive: str) -> Components:
    """The segment `drive` in `root`, which holds the components or the splits that hold them.

    Raises:
        InputError: the folder or the segment does not exist, or is in several splits.
    """
    if not root.is_dir():
        raise InputError(root, "Waymo v2 folder", "does not exist", "check the path")
    splits = [root, *sorted(path for path in root.iterdir() if path.is_dir())]
    name = drive.removesuffix(".parquet")
    check_drive(root, name)
    found = [split for split in splits if (split / "vehicle_pose" / f"{name}.parquet").is_file()]
    if len(found) > 1:
        listed = ", ".join(split.name for split in found)
        raise InputError(
            root,
            f"drive {name}",
            f"is ambiguous: {listed}",
            "name the folder of one of these splits",
        )
    if found:
        return Components(found[0], name)
    others = (path.stem for split in splits for path in split.glob("vehicle_pose/*.parquet"))
    otherwise, problem = "name the folder that holds vehicle_pose", "has no file in vehicle_pose"
    raise unknown_drive(root, name, others, otherwise, problem)


def read_cameras(components: Components) -> dict[str, WaymoCamera]:
    """Cameras by name; none where neither calibrations nor images were downloaded.

    Raises:
        InputError: the file is missing or damaged, or a calibration is wrong or there twice.
    """
    found: dict[str, WaymoCamera] = {}
    if not components.has("camera_calibration") and not components.has("camera_image"):
        return found
    fields = ["width", "height", *_INTRINSIC, "extrinsic.transform", "rolling_shutter_direction"]
    for row in components.table("camera_calibration").rows([CAMERA, *fields]):
        with row.place.errors():
            name = _new_name(row, CAMERA, CAMERA_NAME, found)
            found[name] = camera_calibration(
                row.column("intrinsic"),
                (row.integer("width"), row.integer("height")),
                [row.number(field) for field in _INTRINSIC],
                row.pose("extrinsic"),
                row.choice("rolling_shutter_direction", ROLLING_SHUTTER),
            )
    return found


def read_lasers(components: Components) -> dict[str, LaserCalibration]:
    """LiDARs by name; none where no range images were downloaded.

    Raises:
        InputError: the file is missing or damaged, or a calibration is wrong or there twice.
    """
    found: dict[str, LaserCalibration] = {}
    if not components.has("lidar"):
        return found
    beams, ends = f"{_BEAMS}.values", (f"{_BEAMS}.min", f"{_BEAMS}.max")
    fields = [beams, *ends, "extrinsic.transform"]
    for row in components.table("lidar_calibration").rows([LASER, *fields]):
        with row.place.errors():
            values = row.numbers(beams)
            found[_new_name(row, LASER, LASER_NAME, found)] = laser_calibration(
                (row.column(beams), values),
                {} if len(values) else {row.column(end): row.number(end) for end in ends},
                row.pose("extrinsic"),
            )
    return found


def _new_name(row: WaymoRow, column: str, choice: ProtoEnum, known: Mapping[str, Any]) -> str:
    name = row.choice(column, choice)
    if name in known:
        raise FieldError(column, f"{name} appears twice")
    return name


def read_notes(components: Components) -> dict[str, str]:
    """Statistics of the first frame, and which components are not there."""
    notes: dict[str, str] = {}
    if components.has("stats"):
        for row in components.table("stats").rows(_STATS):
            with row.place.errors():
                notes = {field: row.text(field) for field in _STATS}
            break
    left_out = ", ".join(components.left_out())
    return notes | ({"components_left_out": left_out} if left_out else {})
