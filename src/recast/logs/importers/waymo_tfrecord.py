"""Waymo TFRecords: checksummed records, read one at a time, and the frames of a segment in them.

A segment is read once; its images and range images stay in the file until asked for. Framing:
length as 8 bytes little-endian, its masked CRC-32C in 4, the data, their masked CRC-32C.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import google_crc32c
import numpy as np

from recast.core.errors import InputError
from recast.core.files import disk_errors, kind_of_file
from recast.logs.importers.waymo_proto import FieldError, Message, decode, decode_features
from recast.logs.importers.waymo_segment import (
    MEND,
    FrameEntry,
    ImageEntry,
    LabelEntry,
    LaserCalibration,
    LaserEntry,
    MapFeatures,
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

_HEADER = struct.Struct("<QI")
_FOOTER = struct.Struct("<I")
_MASK = 0xA282EAD8
_EXAMPLE = re.compile(
    rb"\n(?P<length>[\x80-\xff]*[\x00-\x7f])\n[\x80-\xff]*[\x00-\x7f]"
    rb"\n(?P<size>.)(?P<name>[ -~]+?)\x12",
    re.DOTALL,
)
"""How a tf.Example begins: its features, the first of them, and its name."""
_STATS = ("time_of_day", "location", "weather")
_END = 64
"""Bytes by which a part of a record is found."""
_LARGEST = 1 << 24
"""Bytes of an unpacked matrix; the largest of the dataset has four million."""


@dataclass(frozen=True)
class TfRecord:
    """One record."""

    number: int  # number of the record, counted from 0
    offset: int  # offset of the data in the file, bytes
    data: bytes  # data as stored


def masked_crc(data: bytes) -> int:
    """The checksum as stored: rotated and offset, so that checksums of checksums are harmless."""
    crc = google_crc32c.value(data)
    return (((crc >> 15) | (crc << 17)) + _MASK) & 0xFFFFFFFF


def read_records(path: Path) -> Iterator[TfRecord]:
    """All records of a file in order, both checksums of each compared. Raises InputError: no such
    file, not a TFRecord, a record cut off or damaged, or none at all."""
    if not path.is_file():
        raise InputError(path, "TFRecord file", "does not exist", "check the path")
    size, number = path.stat().st_size, 0
    if size == 0:
        raise InputError(path, "record 0", "is missing: the file is empty", MEND)
    with path.open("rb") as file:
        while file.tell() < size:
            record = _read_record(path, file, size, number)
            if number == 0 and (feature := example_feature(record.data)):
                problem = f"is a tf.Example of features such as {feature}, not a frame or scenario"
                mend = "download the segments, or the motion dataset's folder scenario"
                raise InputError(path, "record 0", problem, mend)
            yield record
            number += 1


def example_feature(data: bytes) -> str:
    """The name of a feature if a record is a tf.Example, else empty.

    An Example has one field: a message whose entries have a name each.
    """
    match = _EXAMPLE.match(data)
    if match is None:
        return ""
    length = sum((byte & 127) << (7 * i) for i, byte in enumerate(match["length"]))
    whole = match.end("length") + length == len(data)
    return match["name"].decode() if whole and len(match["name"]) == ord(match["size"]) else ""


def _read_record(path: Path, file: BinaryIO, size: int, number: int) -> TfRecord:
    header = file.read(_HEADER.size)
    where = f"record {number}"
    if len(header) < _HEADER.size:
        raise InputError(path, f"{where}, length", "is cut off", MEND)
    length, length_crc = _HEADER.unpack(header)
    if masked_crc(header[:8]) != length_crc:
        if number == 0:
            file.seek(0)
            kind = kind_of_file(file.read(512))
            problem, mend = "the file is not an uncompressed TFRecord", "name a .tfrecord file"
            problem += f" but {kind}" if kind else ""
        else:
            problem, mend = "does not match its checksum", MEND
        raise InputError(path, f"{where}, length", problem, mend)
    offset = file.tell()
    missing = length + _FOOTER.size - (size - offset)
    if missing > 0:
        raise InputError(path, f"{where}, data", f"are cut off, {missing} bytes are missing", MEND)
    data = file.read(length)
    if masked_crc(data) != _FOOTER.unpack(file.read(_FOOTER.size))[0]:
        raise InputError(path, f"{where}, data", "do not match their checksum", MEND)
    return TfRecord(number, offset, data)


def read_segment(path: Path) -> Segment:
    """Go through a segment once, checking every checksum; no more than a record is in memory.
    Raises InputError: the file is damaged, a field is missing or unknown, frames are of several
    segments or out of order."""
    frames: list[FrameEntry] = []
    context: Message | None = None
    map_features: MapFeatures | None = None
    for record in read_records(path):
        place = Place(path, f"record {record.number}")
        with place.errors():
            message = decode("Frame", record.data)
            _check_same_segment(context, message)
            entry = _frame(place, record, message)
            if frames and entry.start_us <= frames[-1].start_us:
                raise FieldError("timestamp_micros", "is not later than the frame before")
            if map_features is None and (stored := message["map_features"]):
                features = decode_features(stored)
                map_features = MapFeatures(place, features, _map_offset(message))
        frames.append(entry)
        context = context or message["context"]
    assert context is not None  # read_records refuses a file without records
    with frames[0].place.errors():
        cameras = {m["name"]: _camera(m) for m in context["camera_calibrations"]}
        lasers = {m["name"]: _laser_calibration(m) for m in context["laser_calibrations"]}
        stats = context.get("stats")
        known = {} if stats is None else {name: stats.get(name) for name in _STATS}
        notes = {name: text for name, text in known.items() if text is not None}
        return Segment(context["name"], cameras, lasers, tuple(frames), notes, map_features)


def _check_same_segment(context: Message | None, message: Message) -> None:
    name = message["context"]["name"]
    if context is not None and name != context["name"]:
        problem = f"is {name!r}, but the frames before are of {context['name']!r}"
        raise FieldError("context.name", problem)


def _transform(message: Message, name: str) -> Array:
    """The (4, 4) pose in the field `name`; raises FieldError where it is none."""
    return rigid(message[name]["transform"], f"{message.path(name)}.transform")


def _camera(message: Message) -> WaymoCamera:
    intrinsic = message["intrinsic"]
    if len(intrinsic) != 9:
        raise FieldError(message.path("intrinsic"), f"has {len(intrinsic)} numbers, not 9")
    return camera_calibration(
        message.where,
        (message["width"], message["height"]),
        intrinsic.tolist(),
        _transform(message, "extrinsic"),
        message.get("rolling_shutter_direction", "unknown"),
    )


def _laser_calibration(message: Message) -> LaserCalibration:
    values = message["beam_inclinations"]
    ends = () if len(values) else ("beam_inclination_min", "beam_inclination_max")
    return laser_calibration(
        (message.path("beam_inclinations"), values),
        {message.path(end): message[end] for end in ends},
        _transform(message, "extrinsic"),
    )


def _frame(place: Place, record: TfRecord, message: Message) -> FrameEntry:
    images: dict[str, ImageEntry] = {}
    lasers: dict[str, LaserEntry] = {}
    start_us = frame_time(message["timestamp_micros"], message.path("timestamp_micros"))
    for image in message["images"]:
        name = _new_name(image, images)
        images[name] = _image(image, _part_of(place, record, image, "image"), start_us)
    for laser in message["lasers"]:
        returns = _laser(place, record, laser)
        if returns is not None:
            lasers[_new_name(laser, lasers)] = returns
    labels = tuple(_label(place, label) for label in message["laser_labels"])
    return FrameEntry(place, start_us, _transform(message, "pose"), images, lasers, labels)


def _new_name(message: Message, known: Mapping[str, object]) -> str:
    name: str = message["name"]
    if name in known:
        raise FieldError(message.path("name"), f"{name} appears twice")
    return name


def _image(image: Message, jpeg: FilePart, start_us: int) -> ImageEntry:
    names = ("pose_timestamp", "shutter", "camera_trigger_time", "camera_readout_done_time")
    seconds = {image.path(name): image[name] for name in names}
    return image_entry(jpeg, _transform(image, "pose"), seconds, start_us)


def _laser(place: Place, record: TfRecord, laser: Message) -> LaserEntry | None:
    """None where it has no range image at all: some files come without, to be small."""
    parts, poses = [], None
    for name in ("return1", "return2"):
        image = laser.get(name)
        if image is None or image.get("range_image_compressed") is None:
            continue
        parts.append(PackedMatrix(_part_of(place, record, image, "range_image_compressed")))
        if name == "return1" and image.get("pose_compressed") is not None:
            poses = PackedMatrix(_part_of(place, record, image, "pose_compressed"))
    return LaserEntry(tuple(parts), poses) if parts else None


def _part_of(place: Place, record: TfRecord, message: Message, name: str) -> FilePart:
    data = message[name]
    return FilePart(
        place.inside(message.path(name)), record.offset + _find(data, record), len(data)
    )


def _find(part: bytes, record: TfRecord) -> int:
    """Where a part of a record begins, which protobuf does not tell.

    Files of one kind begin alike, but end differently.
    """
    end = part[-_END:]
    at = len(part) - len(end)
    while not record.data.startswith(
        part, (at := record.data.index(end, at)) - len(part) + len(end)
    ):
        at += 1
    return at - len(part) + len(end)


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
    """Bytes of a file; `StoredBytes`."""

    place: Place  # place of the bytes, for messages
    offset: int  # offset in the file, bytes
    size: int  # number of bytes
    sealed: bool = True  # the record's checksum has been compared

    def read(self) -> bytes:
        """The bytes."""
        with disk_errors(self.place.path), self.place.path.open("rb") as file:
            file.seek(self.offset)
            return file.read(self.size)


@dataclass(frozen=True)
class PackedMatrix:
    """A matrix as a zlib stream of a MatrixFloat message; `StoredMatrix`."""

    part: FilePart

    @property
    def place(self) -> Place:
        """Where it is written."""
        return self.part.place

    def read(self, channels: int) -> Float32Array:
        """The (H, W, channels) float32 matrix. Raises InputError: it is empty, damaged, or of
        another shape."""
        if self.part.size == 0:
            raise self.place.error("is empty")
        try:
            stream = zlib.decompressobj()
            data = stream.decompress(self.part.read(), _LARGEST)
        except zlib.error as error:
            raise self.place.error(f"is not a zlib stream ({error})") from None
        if not stream.eof:
            raise self.place.error("is cut off or too large")
        try:
            message = decode("MatrixFloat", data)
            values, dims = message["data"], message["shape"]["dims"].tolist()
        except FieldError as error:
            raise self.place.error(f"does not contain a matrix: {error}") from None
        try:
            return shaped(values, dims, channels)
        except ValueError as error:
            raise self.place.error(str(error)) from None
