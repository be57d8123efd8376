"""map.json: lanes, drivable area and ground height beside a log, one versioned text file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import numpy as np

from recast.core import files
from recast.core.records import Record, read_record
from recast.logs.checks import refused
from recast.logs.hdmap import Array, GroundHeight, HdMap, Lane

VERSION = 1

Point2 = tuple[float, float]
Point3 = tuple[float, float, float]


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
    hd_map.validate()
    files.write_text(path, _layout(_to_json(hd_map)))


def read_map(path: str | Path) -> HdMap:
    """Read a map.json.

    Raises:
        InputError: missing, not a map.json, of another version, or a field of the wrong kind.
    """
    mend = "import the drive again with this recast"
    model = read_record(path, _MapModel, VERSION, mend, "recast-map")
    with refused(path, mend):
        hd_map = _from_model(model)
        hd_map.validate()
    return hd_map


def _to_json(hd_map: HdMap) -> dict[str, Any]:
    lanes = [
        {
            "lane_id": lane.lane_id,
            "speed_limit": lane.speed_limit,
            "is_intersection": lane.is_intersection,
            "successors": list(lane.successors),
            "left_neighbour": lane.left_neighbour,
            "right_neighbour": lane.right_neighbour,
            "centreline": lane.centreline.tolist(),
            "left_boundary": lane.left_boundary.tolist(),
            "right_boundary": lane.right_boundary.tolist(),
            "polygon": lane.polygon.tolist(),
        }
        for lane in hd_map.lanes.values()
    ]
    ground = hd_map.ground
    return {
        "format": "recast-map",
        "version": VERSION,
        "derived": hd_map.derived,
        "notes": dict(hd_map.notes),
        "lanes": lanes,
        "drivable_area": [outline.tolist() for outline in hd_map.drivable_area],
        "ground": None
        if ground is None
        else {
            "origin": ground.origin.tolist(),
            "cell": ground.cell,
            "height": [[None if np.isnan(h) else h for h in row] for row in ground.height.tolist()],
        },
    }


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
        raise ValueError("lanes: two have the same lane_id")
    if model.ground is not None and len({len(row) for row in model.ground.height}) > 1:
        raise ValueError("ground.height: rows have different lengths")
    lanes = {
        lane.lane_id: Lane(
            lane_id=lane.lane_id,
            centreline=_array(lane.centreline, 3),
            left_boundary=_array(lane.left_boundary, 3),
            right_boundary=_array(lane.right_boundary, 3),
            polygon=_array(lane.polygon, 2),
            speed_limit=lane.speed_limit,
            successors=tuple(lane.successors),
            left_neighbour=lane.left_neighbour,
            right_neighbour=lane.right_neighbour,
            is_intersection=lane.is_intersection,
        )
        for lane in model.lanes
    }
    ground = model.ground
    return HdMap(
        lanes=lanes,
        drivable_area=tuple(_array(outline, 2) for outline in model.drivable_area),
        ground=None
        if ground is None
        else GroundHeight(
            origin=np.array(ground.origin),
            cell=ground.cell,
            height=np.array(ground.height, np.float64),
        ),
        derived=model.derived,
        notes=model.notes,
    )


def _array(rows: Any, columns: int) -> Array:
    return np.array(rows, np.float64).reshape(-1, columns)
