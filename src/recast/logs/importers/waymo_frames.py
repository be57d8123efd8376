"""Frames of a Waymo segment, read once and one at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from recast.geometry import se3
from recast.logs.importers.waymo_schema import FRAME, MAP_FEATURE
from recast.logs.importers.waymo_segment import (
    FilePart,
    FrameEntry,
    ImageEntry,
    LabelEntry,
    LaserEntry,
    Segment,
    record_errors,
    transform,
)
from recast.logs.importers.waymo_tfrecord import Record, read_records
from recast.logs.importers.waymo_wire import FieldError, Message, decode
from recast.logs.types import Array

_EARLIEST_US, _LATEST_US = -50_000, 150_000
"""Of an image from the start of its frame's turn (in the real frame 22 to 72 ms): within reach of
the ego trajectory, which goes through the images and is continued by 0.15 s."""


def read_segment(path: Path) -> Segment:
    """Go through a segment once, checking every checksum; no more than a record is in memory.

    Raises:
        InputError: the file is damaged, a field is missing or unknown, frames are of several
            segments or out of order.
    """
    frames: list[FrameEntry] = []
    context: Message | None = None
    features: tuple[Message, ...] = ()
    map_record, map_offset = 0, np.zeros(3)
    for record in read_records(path):
        with record_errors(path, record.number):
            message = decode(FRAME, record.data)
            _check_same_segment(context, message)
            entry = _frame(path, record, message)
            if frames and entry.start_us <= frames[-1].start_us:
                raise FieldError("timestamp_micros", "is not later than the frame before")
            if message["map_features"] and not features:
                features = tuple(
                    decode(MAP_FEATURE, record.data, span, f"map_features[{i}]")
                    for i, span in enumerate(message["map_features"])
                )
                map_record, map_offset = record.number, _map_offset(message)
        frames.append(entry)
        context = context or message["context"]
    assert context is not None  # read_records refuses a file without records
    return Segment(path, context, tuple(frames), features, map_record, map_offset)


def _check_same_segment(context: Message | None, message: Message) -> None:
    name = message["context"]["name"]
    if context is not None and name != context["name"]:
        problem = f"is {name!r}, the frames before are of {context['name']!r}"
        raise FieldError("context.name", problem)


def _frame(path: Path, record: Record, message: Message) -> FrameEntry:
    def part(field: str, span: slice) -> FilePart:
        size = span.stop - span.start
        return FilePart(path, record.number, field, record.offset + span.start, size)

    images: dict[str, ImageEntry] = {}
    lasers: dict[str, LaserEntry] = {}
    start_us = message["timestamp_micros"]
    for image in message["images"]:
        entry = _image(image, _part_of(image, "image", part))
        images[_new_name(image, images)] = entry
        if not _EARLIEST_US <= entry.time_us - start_us <= _LATEST_US:
            problem = f"is {(entry.time_us - start_us) / 1e6:g} s after the frame's time"
            raise FieldError(image.path("pose_timestamp"), problem)
    for laser in message["lasers"]:
        returns = _laser(laser, part)
        if returns is not None:
            lasers[_new_name(laser, lasers)] = returns
    return FrameEntry(
        record.number,
        start_us,
        transform(message, "pose"),
        images,
        lasers,
        tuple(_label(label) for label in message["laser_labels"]),
    )


def _new_name(message: Message, known: Mapping[str, object]) -> str:
    name: str = message["name"]
    if name in known:
        raise FieldError(message.path("name"), f"{name} is there twice")
    return name


def _image(image: Message, jpeg: FilePart) -> ImageEntry:
    seconds = {
        name: image[name]
        for name in ("pose_timestamp", "shutter", "camera_trigger_time", "camera_readout_done_time")
    }
    for name, value in seconds.items():
        if not np.isfinite(value):
            raise FieldError(image.path(name), f"is {value}")
    half = seconds["shutter"] / 2
    return ImageEntry(
        jpeg,
        transform(image, "pose"),
        round(seconds["pose_timestamp"] * 1e6),
        round((seconds["camera_trigger_time"] + half) * 1e6),
        round((seconds["camera_readout_done_time"] - half) * 1e6),
    )


def _laser(laser: Message, part: Callable[[str, slice], FilePart]) -> LaserEntry | None:
    """None where it has no range image at all: some files come without, to be small."""
    parts, poses = [], None
    for name in ("return1", "return2"):
        image = laser.get(name)
        if image is None or image.get("range_image_compressed") is None:
            continue
        parts.append(_part_of(image, "range_image_compressed", part))
        if name == "return1" and image.get("pose_compressed") is not None:
            poses = _part_of(image, "pose_compressed", part)
    return LaserEntry(tuple(parts), poses) if parts else None


def _part_of(message: Message, name: str, part: Callable[[str, slice], FilePart]) -> FilePart:
    return part(message.path(name), message[name])


def _label(label: Message) -> LabelEntry:
    box = label["box"]
    names = ("center_x", "center_y", "center_z", "length", "width", "height", "heading")
    values = np.array([box[name] for name in names])
    for name, value in zip(names, values, strict=True):
        if not np.isfinite(value) or (name in ("length", "width", "height") and value <= 0):
            raise FieldError(box.path(name), f"is {value:g}")
    return LabelEntry(
        label["id"], label.get("type", "unknown"), placed_box(values[:3], values[6]), values[3:6]
    )


def placed_box(centre: Array, heading: float) -> Array:
    """Pose (4, 4) of a level box."""
    return se3.from_rotation_translation(se3.rotation_z(heading), centre)


def _map_offset(message: Message) -> Array:
    offset = message.get("map_pose_offset")
    if offset is None:
        return np.zeros(3)
    return np.array([offset.get(axis, 0.0) for axis in "xyz"])
