"""The tables of a Waymo v2 segment joined by their keys into frames.

Images and range images stay in their file until asked for. A row group holds about fifty frames, a
gigabyte of range images when decoded. So rows are decoded one at a time, by one reader for all
sensors of a table. Rows asked for in the order in which they lie cost one pass over the file, so
each sensor on its own costs one; a row that lies before the last one in its row group costs another
pass from the start of the group.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa

from recast.core.errors import InputError
from recast.core.table_files import ParquetRows
from recast.logs.importers.waymo2_tables import (
    CAMERA,
    LASER,
    TIME,
    Components,
    WaymoRow,
    WaymoTable,
    read_cameras,
    read_lasers,
    read_notes,
)
from recast.logs.importers.waymo_proto import (
    CAMERA_NAME,
    LABEL_TYPE,
    LASER_NAME,
    FieldError,
    ProtoEnum,
)
from recast.logs.importers.waymo_segment import (
    MEND,
    FrameEntry,
    ImageEntry,
    LabelEntry,
    LaserEntry,
    Place,
    Segment,
)
from recast.logs.importers.waymo_values import frame_time, image_entry, label_entry, shaped
from recast.logs.types import Array, Float32Array

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
        """The pyarrow scalar in a row (counted from 0).

        Raises:
            InputError: the file is damaged.
        """
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
        """The bytes.

        Raises:
            InputError: the file is damaged, or the cell is empty or holds something else.
        """
        value = self.reader.cell(self.row, self.column).as_py()
        if value is None:
            raise self.place.error("is empty")
        if not isinstance(value, bytes):
            raise self.place.error(f"holds {type(value).__name__}, not bytes")
        return value


@dataclass(frozen=True)
class MatrixCell:
    """A range image in two cells, FIELD.values and FIELD.shape; `StoredMatrix`.

    Attributes:
        shape: shape of the range image, as its cell has it.
    """

    reader: RowReader
    place: Place
    row: int
    column: str
    shape: tuple[int, ...]

    def read(self, channels: int) -> Float32Array:
        """The (H, W, channels) float32 matrix.

        Raises:
            InputError: it is empty, damaged, or of another shape.
        """
        cell = self.reader.cell(self.row, self.column)
        values = getattr(cell, "values", None)
        if values is None or len(values) == 0:
            raise self.place.error("is empty")
        try:
            # An empty element becomes a NaN, which is refused.
            return shaped(values.to_numpy(zero_copy_only=False), self.shape, channels)
        except (TypeError, ValueError) as error:
            raise self.place.error(str(error)) from None
