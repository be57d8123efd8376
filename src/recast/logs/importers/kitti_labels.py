"""KITTI box labels: tracking label files and tracklet_labels.xml."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recast import storage
from recast.errors import InputError
from recast.geometry import se3
from recast.logs.checks import BOX_SIDE, SENSOR_REACH, check_reach, refused
from recast.logs.importers.kitti_files import TEXT_LIMIT
from recast.logs.types import Array, Int64Array

MOST_FRAMES = 10_000_000
"""Frames of a drive: eleven days of them."""

CATEGORIES = {
    "car": "car",
    "van": "van",
    "truck": "truck",
    "bus": "bus",
    "pedestrian": "pedestrian",
    "person": "pedestrian",
    "person_sitting": "pedestrian",
    "person (sitting)": "pedestrian",
    "cyclist": "cyclist",
    "tram": "tram",
    "misc": "misc",
}


@dataclass(frozen=True)
class LabelledTrack:
    """Boxes of one object in the sensor frame they were labelled in.

    Attributes:
        frames: (F,) frame numbers, ascending.
        sensor_from_box: (F, 4, 4), origin at the box centre, x forward, z up.
        size: (3,) length, width, height in metres.
    """

    track_id: str
    category: str
    frames: Int64Array
    sensor_from_box: Array
    size: Array


def read_tracking_labels(path: Path) -> list[LabelledTrack]:
    """Read a KITTI tracking label file: boxes in the rectified frame of camera 0.

    A row: frame, track, type, truncated, occluded, alpha, image box (4), height, width, length,
    x, y, z of the bottom centre, rotation_y. DontCare rows are skipped. Source: KITTI tracking
    development kit, readme.txt.

    Raises:
        InputError: missing, or a row is malformed.
    """
    rows: dict[int, list[tuple[str, Array]]] = {}
    for number, line in enumerate(storage.read_text(path, TEXT_LIMIT).split("\n"), start=1):
        words = line.split()
        if not words or words[2:3] == ["DontCare"]:
            continue
        mend = "name a KITTI tracking label file (17 columns)"
        if len(words) < 17:
            raise InputError(path, f"line {number}", f"{len(words)} of 17 columns", mend)
        try:
            frame, track = int(words[0]), int(words[1])
            values = np.array([float(word) for word in words[10:17]])
        except ValueError as error:
            raise InputError(path, f"line {number}", str(error), mend) from None
        if not 0 <= frame < MOST_FRAMES:
            raise InputError(path, f"line {number}", f"frame {frame} is none", mend)
        with refused(path, mend):
            _check_box(f"line {number}", values[:3], values[3:])
        category = _category(words[2], path, f"line {number}")
        rows.setdefault(track, []).append((category, np.array([frame, *values])))
    return [_tracking_track(path, track, rows[track]) for track in sorted(rows)]


def _check_box(where: str, size: Array, places: Array) -> None:
    """Check sides (3,), and places (..., 4) in metres with a heading in radians."""
    least, most = BOX_SIDE
    if not np.all((size >= least) & (size <= most)):
        raise ValueError(f"{where}: a box has three sides of {least} to {most} m")
    check_reach(f"{where}: place", places[..., :3], SENSOR_REACH)
    check_reach(f"{where}: heading", places[..., 3], SENSOR_REACH)


def _tracking_track(path: Path, track: int, rows: list[tuple[str, Array]]) -> LabelledTrack:
    values = np.array(sorted((row for _, row in rows), key=lambda row: row[0]))
    frames: Int64Array = values[:, 0].astype(np.int64)
    if np.any(np.diff(frames) == 0):
        twice = frames[np.flatnonzero(np.diff(frames) == 0)[0]]
        raise InputError(
            path, f"track {track}", f"is twice in frame {twice}", "remove one of the two rows"
        )
    height, width, length = np.median(values[:, 1:4], axis=0)
    cos, sin, zero = np.cos(values[:, 7]), np.sin(values[:, 7]), np.zeros(len(values))
    forward = np.stack([cos, zero, -sin], axis=-1)
    left = np.stack([sin, zero, cos], axis=-1)
    up = np.broadcast_to([0.0, -1.0, 0.0], forward.shape)
    rotation = np.stack([forward, left, up], axis=-1)
    centre = values[:, 4:7] + up * (values[:, 1:2] / 2)
    return LabelledTrack(
        track_id=str(track),
        category=rows[0][0],
        frames=frames,
        sensor_from_box=se3.from_rotation_translation(rotation, centre),
        size=np.array([length, width, height]),
    )


def read_tracklets(path: Path) -> list[LabelledTrack]:
    """Read tracklet_labels.xml: boxes in the velodyne frame; a track id is its place in the file.

    Poses there are of the bottom centre; half the height is added. Source: KITTI raw development
    kit, readTracklets.

    Raises:
        InputError: missing, not XML, or a tracklet lacks a field.
    """
    mend = "download it again"
    text = storage.read_text(path, TEXT_LIMIT)
    if "<!ENTITY" in text:  # which can multiply; KITTI has none
        raise InputError(path, "XML", "defines entities", mend)
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise InputError(path, "XML", f"cannot be read ({error})", mend) from None
    tracks = []
    for number, item in enumerate(root.findall("tracklets/item")):
        where = f"tracklet {number}"
        size = np.array([_number(item, key, path, where) for key in ("l", "w", "h")])
        poses = [
            [_number(pose, key, path, where) for key in ("tx", "ty", "tz", "rz")]
            for pose in item.findall("poses/item")
        ]
        first = _number(item, "first_frame", path, where)
        if not poses or not (first.is_integer() and 0 <= first < MOST_FRAMES):
            raise InputError(path, where, f"{len(poses)} poses from frame {first:g} on", mend)
        values = np.array(poses)
        with refused(path, mend):
            _check_box(where, size, values)
        centre = values[:, :3] + [0.0, 0.0, size[2] / 2]
        tracks.append(
            LabelledTrack(
                track_id=str(number),
                category=_category(item.findtext("objectType", ""), path, where),
                frames=int(first) + np.arange(len(values), dtype=np.int64),
                sensor_from_box=se3.from_rotation_translation(se3.rotation_z(values[:, 3]), centre),
                size=size,
            )
        )
    return tracks


def _number(element: ElementTree.Element, key: str, path: Path, where: str) -> float:
    text = element.findtext(key)
    try:
        value = float(text if text is not None else "")
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise InputError(path, f"{where}.{key}", f"is {text!r}", "download it again")
    return value


def _category(name: str, path: Path, where: str) -> str:
    try:
        return CATEGORIES[name.strip().lower()]
    except KeyError:
        raise InputError(path, where, f"unknown type {name!r}", "name a KITTI label file") from None
