"""map.json: lanes, drivable area and ground height beside a log, one versioned text file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import numpy as np

from recast.core import files
from recast.core.records import Record, parse_record
from recast.logs.checks import refused
from recast.logs.hdmap import Array, GroundHeight, HdMap, Lane

VERSION = 1

Point2 = tuple[float, float]
Point3 = tuple[float, float, float]


_LINES = {"centreline": 3, "left_boundary": 3, "right_boundary": 3, "polygon": 2}
"""Of a lane, and numbers of a point."""


class _LaneModel(Record):
    lane_id: str
    speed_limit: float | None
    is_intersection: bool
    successors: list[str]
    left_neighbour: str | None
    right_neighbour: str | None
    centreline: list[Point3]
    left_boundary: list[Point3]
    right_boundary: list[Point3]
    polygon: list[Point2]


class _GroundModel(Record):
    origin: Point2
    cell: float
    height: list[list[float | None]]


class _MapModel(Record):
    format: Literal["recast-map"]
    version: Literal[1]
    derived: bool
    notes: dict[str, str]
    lanes: list[_LaneModel]
    drivable_area: list[list[Point2]]
    ground: _GroundModel | None


def write_map(hd_map: HdMap, path: str | Path) -> None:
    """Write `hd_map` to `path`, whole or not at all; floats keep every digit.

    Raises:
        ValueError: the map is not valid.
    """
    files.write_text(path, map_text(hd_map))


def map_text(hd_map: HdMap) -> str:
    """The content of a map.json.

    Raises:
        ValueError: the map is not valid.
    """
    hd_map.validate()
    return _layout(_to_json(hd_map))


def read_map(path: str | Path) -> HdMap:
    """Read a map.json.

    Raises:
        InputError: missing, not a map.json, of another version, or a field of the wrong kind.
    """
    return parse_map(path, files.read_json(path))


def parse_map(where: str | Path, value: Any) -> HdMap:
    """The map of a map.json's JSON data, which was read from `where`.

    Raises:
        InputError: no map.json, of another version, or a field of the wrong kind.
    """
    mend = "import the drive again with this version of recast"
    model = parse_record(where, value, _MapModel, VERSION, mend, "recast-map")
    with refused(where, mend):
        hd_map = _from_model(model)
        hd_map.validate()
    return hd_map


def _to_json(hd_map: HdMap) -> dict[str, Any]:
    ground = hd_map.ground
    return {
        "format": "recast-map",
        "version": VERSION,
        "derived": hd_map.derived,
        "notes": dict(hd_map.notes),
        "lanes": [_members(lane, _LaneModel) for lane in hd_map.lanes.values()],
        "drivable_area": [outline.tolist() for outline in hd_map.drivable_area],
        "ground": None if ground is None else _members(ground, _GroundModel),
    }


def _members(value: Lane | GroundHeight, model: type[Record]) -> dict[str, Any]:
    return {name: _plain(getattr(value, name)) for name in model.model_fields}


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return np.where(np.isnan(value), None, value).tolist()  # type: ignore[call-overload]
    return list(value) if isinstance(value, tuple) else value


def _layout(data: dict[str, Any]) -> str:
    """JSON with one line a field, and one line an element of the long lists."""
    fields = []
    for key, value in data.items():
        if isinstance(value, list) and value:
            rows = ",\n".join("  " + _compact(item) for item in value)
            text = f"[\n{rows}\n]"
        else:
            text = _compact(value)
        fields.append(f'"{key}": {text}')
    return "{\n" + ",\n".join(fields) + "\n}\n"


def _compact(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def _from_model(model: _MapModel) -> HdMap:
    if len({lane.lane_id for lane in model.lanes}) != len(model.lanes):
        raise ValueError("lanes: two lanes have the same lane_id")
    if model.ground is not None and len({len(row) for row in model.ground.height}) > 1:
        raise ValueError("ground.height: rows have different lengths")
    lanes = {}
    for lane in model.lanes:
        members: dict[str, Any] = lane.model_dump(exclude=set(_LINES))
        members |= {name: _array(getattr(lane, name), width) for name, width in _LINES.items()}
        lanes[lane.lane_id] = Lane(**(members | {"successors": tuple(lane.successors)}))
    ground = None
    if model.ground is not None:
        height = np.array(model.ground.height, np.float64)
        ground = GroundHeight(np.array(model.ground.origin), model.ground.cell, height)
    outlines = tuple(_array(outline, 2) for outline in model.drivable_area)
    return HdMap(lanes, outlines, ground, model.derived, model.notes)


def _array(rows: Any, columns: int) -> Array:
    return np.array(rows, np.float64).reshape(-1, columns)
