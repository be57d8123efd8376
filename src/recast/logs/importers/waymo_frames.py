"""Frames of a Waymo TFRecord segment, read once and one at a time; large fields when asked for."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recast.core.errors import InputError
from recast.core.files import disk_errors
from recast.logs.importers.waymo_schema import FRAME, MAP_FEATURE, MATRIX_FLOAT
from recast.logs.importers.waymo_segment import (
    MEND,
    CameraCalibration,
    FrameEntry,
    ImageEntry,
    LabelEntry,
    LaserCalibration,
    LaserEntry,
    MapFeatures,
    Place,
    Segment,
)
from recast.logs.importers.waymo_tfrecord import Record, read_records
from recast.logs.importers.waymo_values import (
    camera_calibration,
    frame_time,
    image_entry,
    label_entry,
    laser_calibration,
    rigid,
    shaped,
)
from recast.logs.importers.waymo_wire import FieldError, Message, decode
from recast.logs.types import Array, Float32Array

_LARGEST = 1 << 24
"""Bytes of an unpacked matrix; the largest of the dataset has four million."""


def read_segment(path: Path) -> Segment:
    """Go through a segment once, checking every checksum; no more than a record is in memory.

    Raises:
        InputError: the file is damaged, a field is missing or unknown, frames are of several
            segments or out of order.
    """
    frames: list[FrameEntry] = []
    context: Message | None = None
    map_features: MapFeatures | None = None
    for record in read_records(path):
        place = Place(path, f"record {record.number}")
        with place.errors():
            message = decode(FRAME, record.data)
            _check_same_segment(context, message)
            entry = _frame(place, record, message)
            if frames and entry.start_us <= frames[-1].start_us:
                raise FieldError("timestamp_micros", "is not later than the frame before")
            if message["map_features"] and map_features is None:
                features = tuple(
                    decode(MAP_FEATURE, record.data, span, f"map_features[{i}]")
                    for i, span in enumerate(message["map_features"])
                )
                map_features = MapFeatures(place, features, _map_offset(message))
        frames.append(entry)
        context = context or message["context"]
    assert context is not None  # read_records refuses a file without records
    with frames[0].place.errors():
        cameras = {m["name"]: _camera(m) for m in context["camera_calibrations"]}
        lasers = {m["name"]: _laser_calibration(m) for m in context["laser_calibrations"]}
        stats = context.get("stats", Message(""))
        notes = {key: str(value) for key, value in stats.values.items()}
        return Segment(context["name"], cameras, lasers, tuple(frames), notes, map_features)


def _check_same_segment(context: Message | None, message: Message) -> None:
    name = message["context"]["name"]
    if context is not None and name != context["name"]:
        problem = f"is {name!r}, the frames before are of {context['name']!r}"
        raise FieldError("context.name", problem)


def transform(message: Message, name: str) -> Array:
    """The (4, 4) pose in the field `name`.

    Raises:
        FieldError: missing, not 16 numbers, or no rotation and translation.
    """
    return rigid(message[name]["transform"], f"{message.path(name)}.transform")


def _camera(message: Message) -> CameraCalibration:
    intrinsic = message["intrinsic"]
    if len(intrinsic) != 9:
        raise FieldError(message.path("intrinsic"), f"has {len(intrinsic)} numbers, not 9")
    return camera_calibration(
        message.where,
        (message["width"], message["height"]),
        intrinsic.tolist(),
        transform(message, "extrinsic"),
        message.get("rolling_shutter_direction", "unknown"),
    )


def _laser_calibration(message: Message) -> LaserCalibration:
    values = message["beam_inclinations"].astype(np.float64)
    ends = () if len(values) else ("beam_inclination_min", "beam_inclination_max")
    return laser_calibration(
        (message.path("beam_inclinations"), values),
        {message.path(end): message[end] for end in ends},
        transform(message, "extrinsic"),
    )


def _frame(place: Place, record: Record, message: Message) -> FrameEntry:
    def part(field: str, span: slice) -> FilePart:
        return FilePart(place.inside(field), record.offset + span.start, span.stop - span.start)

    images: dict[str, ImageEntry] = {}
    lasers: dict[str, LaserEntry] = {}
    start_us = frame_time(message["timestamp_micros"], message.path("timestamp_micros"))
    for image in message["images"]:
        entry = _image(image, _part_of(image, "image", part), start_us)
        images[_new_name(image, images)] = entry
    for laser in message["lasers"]:
        returns = _laser(laser, part)
        if returns is not None:
            lasers[_new_name(laser, lasers)] = returns
    labels = tuple(_label(place, label) for label in message["laser_labels"])
    return FrameEntry(place, start_us, transform(message, "pose"), images, lasers, labels)


def _new_name(message: Message, known: Mapping[str, object]) -> str:
    name: str = message["name"]
    if name in known:
        raise FieldError(message.path("name"), f"{name} is there twice")
    return name


def _image(image: Message, jpeg: FilePart, start_us: int) -> ImageEntry:
    names = ("pose_timestamp", "shutter", "camera_trigger_time", "camera_readout_done_time")
    seconds = {image.path(name): image[name] for name in names}
    return image_entry(jpeg, transform(image, "pose"), seconds, start_us)


def _laser(laser: Message, part: Callable[[str, slice], FilePart]) -> LaserEntry | None:
    """None where it has no range image at all: some files come without, to be small."""
    parts, poses = [], None
    for name in ("return1", "return2"):
        image = laser.get(name)
        if image is None or image.get("range_image_compressed") is None:
            continue
        parts.append(PackedMatrix(_part_of(image, "range_image_compressed", part)))
        if name == "return1" and image.get("pose_compressed") is not None:
            poses = PackedMatrix(_part_of(image, "pose_compressed", part))
    return LaserEntry(tuple(parts), poses) if parts else None


def _part_of(message: Message, name: str, part: Callable[[str, slice], FilePart]) -> FilePart:
    return part(message.path(name), message[name])


def _label(place: Place, label: Message) -> LabelEntry:
    box = label["box"]
    names = ("center_x", "center_y", "center_z", "length", "width", "height", "heading")
    return label_entry(
        place.inside(label.path("id")),
        label["id"],
        label.get("type", "unknown"),
        {box.path(name): box[name] for name in names},
    )


def _map_offset(message: Message) -> Array:
    offset = message.get("map_pose_offset")
    if offset is None:
        return np.zeros(3)
    return np.array([offset.get(axis, 0.0) for axis in "xyz"])


@dataclass(frozen=True)
class FilePart:
    """Bytes of a file; `StoredBytes`.

    Attributes:
        place: for messages.
        offset, size: in bytes.
        sealed: the record's checksum has been compared.
    """

    place: Place
    offset: int
    size: int
    sealed: bool = True

    def read(self) -> bytes:
        """The bytes."""
        with disk_errors(self.place.path), self.place.path.open("rb") as file:
            file.seek(self.offset)
            return file.read(self.size)

    def error(self, problem: str, mend: str = MEND) -> InputError:
        """An error that names file, record and field."""
        return self.place.error(problem, mend)


@dataclass(frozen=True)
class PackedMatrix:
    """A matrix as a zlib stream of a MatrixFloat message; `StoredMatrix`."""

    part: FilePart

    def error(self, problem: str, mend: str = MEND) -> InputError:
        """An error that names file, record and field."""
        return self.part.error(problem, mend)

    def read(self, channels: int) -> Float32Array:
        """The (H, W, channels) float32 matrix.

        Raises:
            InputError: it is empty, damaged, or of another shape.
        """
        if self.part.size == 0:
            raise self.error("is empty")
        try:
            stream = zlib.decompressobj()
            data = stream.decompress(self.part.read(), _LARGEST)
        except zlib.error as error:
            raise self.error(f"is no zlib stream ({error})") from None
        if not stream.eof:
            raise self.error("is cut off or too large")
        try:
            message = decode(MATRIX_FLOAT, data)
            values, dims = message["data"], message["shape"]["dims"]
        except FieldError as error:
            raise self.error(f"holds no matrix: {error}") from None
        try:
            return shaped(values, dims, channels)
        except ValueError as error:
            raise self.error(str(error)) from None
