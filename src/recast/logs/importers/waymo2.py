"""Tables of Waymo v2: one parquet file for each component of a segment, checked as they are read.

A file lies at COMPONENT/SEGMENT.parquet. Columns are named `key.NAME` (what the row is of) and
`[Component].field`. What holds for a whole segment is here too: calibrations, when and where.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa

from recast.core.errors import InputError
from recast.core.table_files import ROW_LIMIT, ParquetRows
from recast.logs.importers.common import check_drive, unknown_drive
from recast.logs.importers.waymo_proto import (
    CAMERA_NAME,
    LABEL_TYPE,
    LASER_NAME,
    ROLLING_SHUTTER,
    FieldError,
    ProtoEnum,
)
from recast.logs.importers.waymo_segment import (
    MEND,
    FrameEntry,
    ImageEntry,
    LabelEntry,
    LaserCalibration,
    LaserEntry,
    Place,
    Segment,
    WaymoCamera,
    camera_calibration,
    frame_time,
    image_entry,
    label_entry,
    laser_calibration,
    rigid,
    shaped,
)
from recast.logs.types import Array, Float32Array

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
    """A row of a table; its values are checked when asked for, and raise FieldError."""

    table: WaymoTable  # table that has the row
    index: int  # index of the row, counted from 0
    values: Mapping[str, Any]  # values by column

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
    """One component of a segment."""

    path: Path  # its file, named after the segment
    component: str  # name of the component, as in the names of its columns

    def column(self, field: str) -> str:
        """The column of a field; keys are columns already."""
        return field if field.startswith("key.") else f"[{self.component}].{field}"

    def rows(self, fields: Sequence[str]) -> Iterator[WaymoRow]:
        """All rows with the keys (`key.NAME`) and fields asked for, a thousand in memory at once.
        Raises InputError: the file is none, lacks a column, or has rows of another segment."""
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
    Raises InputError: the folder or the segment does not exist, or is in several splits."""
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
    """Cameras by name; none where neither calibrations nor images were downloaded. Raises
    InputError: the file is missing or damaged, or a calibration is wrong or there twice."""
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
    """LiDARs by name; none where no range images were downloaded. Raises InputError: the file is
    missing or damaged, or a calibration is wrong or there twice."""
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


# The tables of a Waymo v2 segment joined by their keys into frames.
#
# Images and range images stay in their file until asked for. A row group holds about fifty frames,
# a gigabyte of range images when decoded. So rows are decoded one at a time, by one reader for all
# sensors of a table. Rows asked for in the order in which they lie cost one pass over the file, so
# each sensor on its own costs one; a row that lies before the last one in its row group costs
# another pass from the start of the group.

LABEL = "key.laser_object_id"
_TOP = "TOP"
_TIMES = [
    "pose_timestamp",
    "rolling_shutter_params.shutter",
    "rolling_shutter_params.camera_trigger_time",
    "rolling_shutter_params.camera_readout_done_time",
]
_BOX = [*(f"box.{part}.{axis}" for part in ("center", "size") for axis in "xyz"), "box.heading"]
_RETURNS = ("range_image_return1", "range_image_return2")

_Entry = TypeVar("_Entry")
_ByFrame = dict[int, dict[str, _Entry]]
"""By the frame's time and the sensor's name."""


def read_segment(components: Components) -> Segment:
    """Everything but the large cells, in the order of time whatever the order of the rows.

    A component that was not downloaded is left out; what is there must be whole.

    Raises:
        InputError: a file is missing or damaged or lacks a column; a value is missing, unknown or
            wrong; a row is of another segment, of no frame, or there twice.
    """
    poses = _poses(components.table("vehicle_pose"))
    images = _images(components, poses)
    lasers = _lasers(components, poses)
    labels = _labels(components, poses)
    frames = tuple(
        FrameEntry(place, time, pose, images[time], lasers[time], tuple(labels[time]))
        for time, (place, pose) in sorted(poses.items())
    )
    cameras, calibrated = read_cameras(components), read_lasers(components)
    return Segment(components.segment, cameras, calibrated, frames, read_notes(components), None)


def _poses(table: WaymoTable) -> dict[int, tuple[Place, Array]]:
    """Place in the file and pose of each frame."""
    poses: dict[int, tuple[Place, Array]] = {}
    for row in table.rows([TIME, "world_from_vehicle.transform"]):
        with row.place.errors():
            time = frame_time(row.integer(TIME), TIME)
            if time in poses:
                raise FieldError(TIME, f"{time} appears twice")
            poses[time] = row.place, row.pose("world_from_vehicle")
    if not poses:
        raise Place(table.path, "rows").error("there are none")
    return poses


def _key(
    row: WaymoRow, column: str, choice: ProtoEnum, found: Mapping[int, Mapping]
) -> tuple[int, str]:
    """Frame and sensor of a row."""
    time, name = _frame_of(row, found), row.choice(column, choice)
    if name in found[time]:
        raise FieldError(column, f"{name} appears twice at {time}")
    return time, name


def _frame_of(row: WaymoRow, frames: Mapping[int, Any]) -> int:
    time = row.integer(TIME)
    if time not in frames:
        raise FieldError(TIME, f"{time} is not the time of a frame in vehicle_pose")
    return time


def _images(components: Components, times: Iterable[int]) -> _ByFrame[ImageEntry]:
    found: _ByFrame[ImageEntry] = {time: {} for time in times}
    if not components.has("camera_image"):
        return found
    table = components.table("camera_image")
    column = table.column("image")
    reader = RowReader(table.path, [column])
    for row in table.rows([TIME, CAMERA, "pose.transform", *_TIMES]):
        with row.place.errors():
            time, name = _key(row, CAMERA, CAMERA_NAME, found)
            cell = BytesCell(reader, row.place.inside(column), row.index, column)
            seconds = {row.column(field): row.number(field) for field in _TIMES}
            found[time][name] = image_entry(cell, row.pose("pose"), seconds, time)
    return found


def _lasers(components: Components, times: Iterable[int]) -> _ByFrame[LaserEntry]:
    found: _ByFrame[LaserEntry] = {time: {} for time in times}
    if not components.has("lidar"):
        return found
    poses = _matrices(components.table("lidar_pose"), _RETURNS[:1], found)
    for time, sensors in _matrices(components.table("lidar"), _RETURNS, found).items():
        for name, returns in sensors.items():
            pose = poses[time].get(name, (None,))[0]
            if name == _TOP and pose is None:
                raise returns[0].place.error(
                    "the LiDAR TOP has no row in lidar_pose at the frame's time"
                )
            found[time][name] = LaserEntry(returns, pose)
    return found


def _matrices(
    table: WaymoTable, fields: tuple[str, ...], times: Iterable[int]
) -> _ByFrame[tuple[MatrixCell, ...]]:
    """The range images of each row: the first field must be there, others may be empty."""
    found: _ByFrame[tuple[MatrixCell, ...]] = {time: {} for time in times}
    columns = {field: table.column(f"{field}.values") for field in fields}
    reader = RowReader(table.path, list(columns.values()))
    shapes = [f"{field}.shape" for field in fields]
    for row in table.rows([TIME, LASER, *shapes]):
        with row.place.errors():
            time, name = _key(row, LASER, LASER_NAME, found)
            cells = []
            for field, column in columns.items():
                shape = tuple(int(length) for length in row.numbers(f"{field}.shape"))
                if not shape and field == fields[0]:
                    raise FieldError(row.column(f"{field}.shape"), "is empty")
                if shape:
                    cells.append(
                        MatrixCell(reader, row.place.inside(column), row.index, column, shape)
                    )
            found[time][name] = tuple(cells)
    return found


def _labels(components: Components, times: Iterable[int]) -> dict[int, list[LabelEntry]]:
    found: dict[int, list[LabelEntry]] = {time: [] for time in times}
    if not components.has("lidar_box"):
        return found
    for row in components.table("lidar_box").rows([TIME, LABEL, "type", *_BOX]):
        with row.place.errors():
            box = {row.column(field): row.number(field) for field in _BOX}
            category = row.choice("type", LABEL_TYPE)
            entry = label_entry(row.place.inside(LABEL), row.text(LABEL), category, box)
            found[_frame_of(row, found)].append(entry)
    return found


class RowReader:
    """Some columns of a parquet file, row by row; no more than a row is kept.

    Raises:
        InputError: the file is none, or lacks a column.
    """

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self._file = ParquetRows(path, columns, MEND)
        self._batches: Iterator[pa.RecordBatch] = iter(())
        self._group, self._at = -1, -1
        self._row: pa.RecordBatch | None = None

    def cell(self, row: int, column: str) -> Any:
        """The pyarrow scalar in a row (counted from 0). Raises InputError: the file is damaged."""
        first_rows = self._file.first_rows
        group = int(np.searchsorted(first_rows, row, side="right")) - 1
        if group != self._group or row < self._at:
            self._batches = self._file.batches(group, rows_at_once=1)
            self._group, self._at = group, int(first_rows[group]) - 1
        try:
            while self._at < row:
                self._row = None  # frees it before the next is decoded
                self._row = next(self._batches)
                self._at += 1
        except InputError:
            self._group = -1
            raise
        assert self._row is not None
        return self._row[column][0]


@dataclass(frozen=True)
class BytesCell:
    """Bytes in a cell; `StoredBytes`. The tables come without checksums."""

    reader: RowReader
    place: Place
    row: int
    column: str
    sealed: bool = False

    def read(self) -> bytes:
        """The bytes. Raises InputError: the file is damaged, or the cell is empty or holds
        something else."""
        value = self.reader.cell(self.row, self.column).as_py()
        if value is None:
            raise self.place.error("is empty")
        if not isinstance(value, bytes):
            raise self.place.error(f"holds {type(value).__name__}, not bytes")
        return value


@dataclass(frozen=True)
class MatrixCell:
    """A range image in two cells, FIELD.values and FIELD.shape; `StoredMatrix`."""

    reader: RowReader
    place: Place
    row: int
    column: str
    shape: tuple[int, ...]  # shape of the range image, as its cell has it

    def read(self, channels: int) -> Float32Array:
        """The (H, W, channels) float32 matrix. Raises InputError: it is empty, damaged, or of
        another shape."""
        cell = self.reader.cell(self.row, self.column)
        values = getattr(cell, "values", None)
        if values is None or len(values) == 0:
            raise self.place.error("is empty")
        try:
            # An empty element becomes a NaN, which is refused.
            return shaped(values.to_numpy(zero_copy_only=False), self.shape, channels)
        except (TypeError, ValueError) as error:
            raise self.place.error(str(error)) from None
