"""Lanes and drivable area, in the log's world frame."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import shapely

from recast.arrays import Array
from recast.core import files
from recast.core.records import Record, parse_record
from recast.logs import checks
from recast.logs.checks import refused

FASTEST = 200.0
"""Metres a second: highest speed limit."""


@dataclass(frozen=True)
class Lane:
    """One lane segment.

    Attributes:
        lane_id: id of the lane, unique in the map.
        centreline, left_boundary, right_boundary: (N, 3) metres, in driving direction.
        polygon: (M, 2) counter-clockwise outline.
        speed_limit: m/s, or None where unknown.
        successors: lanes one can drive on into.
        left_neighbour, right_neighbour: adjacent lane of the same direction, or None.
        is_intersection: whether the lane is inside a junction.
    """

    lane_id: str
    centreline: Array
    left_boundary: Array
    right_boundary: Array
    polygon: Array
    speed_limit: float | None = None
    successors: tuple[str, ...] = ()
    left_neighbour: str | None = None
    right_neighbour: str | None = None
    is_intersection: bool = False


@dataclass(frozen=True)
class GroundHeight:
    """Ground height on a regular grid.

    Attributes:
        origin: (2,) x, y of the centre of cell [0, 0], metres.
        cell: metres.
        height: (rows along y, columns along x) float64, NaN where unknown.
    """

    origin: Array
    cell: float
    height: Array

    def at(self, points: Array) -> Array:
        """Heights (...) under points (..., 2), nearest cell; NaN outside or where unknown."""
        index = np.rint((np.asarray(points, np.float64) - self.origin) / self.cell).astype(int)
        col, row = index[..., 0], index[..., 1]
        rows, cols = self.height.shape
        inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        return np.where(
            inside, self.height[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)], np.nan
        )

    def validate(self) -> None:
        """Raise ValueError naming the field at fault."""
        where = "GroundHeight"
        if self.origin.shape != (2,):
            raise ValueError(f"{where}.origin: expected (2,), got {self.origin.shape}")
        checks.check_reach(f"{where}.origin", self.origin, checks.WORLD_REACH)
        least, most = checks.BOX_SIDE
        if not least <= self.cell <= most:
            raise ValueError(f"{where}.cell: {self.cell} is not within {least} to {most} m")
        if self.height.ndim != 2 or self.height.size == 0:
            raise ValueError(f"{where}.height: expected (rows, columns), got {self.height.shape}")
        known = self.height[~np.isnan(self.height)]
        checks.check_reach(f"{where}.height", known, checks.WORLD_REACH)


@dataclass(frozen=True)
class HdMap:
    """Lanes and drivable area.

    Attributes:
        lanes: lanes by id.
        drivable_area: outlines (N, 2); where they overlap, each still counts (a union).
        ground: ground height, or None.
        derived: True where made from the drive itself, not surveyed.
    """

    lanes: Mapping[str, Lane]
    drivable_area: tuple[Array, ...]
    ground: GroundHeight | None = None
    derived: bool = False
    notes: Mapping[str, str] = field(default_factory=dict)

    def validate(self) -> None:
        """Raise ValueError naming the lane and field at fault."""
        for key, lane in self.lanes.items():
            where = f"HdMap.lanes[{key!r}]"
            checks.check_name(where, key)
            if lane.lane_id != key:
                raise ValueError(f"{where}.lane_id: is {lane.lane_id!r}, not the lane's key")
            for name in ("centreline", "left_boundary", "right_boundary"):
                checks.check_lines(f"{where}.{name}", getattr(lane, name), columns=3, least=2)
            checks.check_lines(f"{where}.polygon", lane.polygon, columns=2, least=3)
            limit = lane.speed_limit
            if limit is not None and not 0 < limit <= FASTEST:
                raise ValueError(f"{where}.speed_limit: {limit} m/s is not within 0 to {FASTEST}")
            linked = (*lane.successors, lane.left_neighbour, lane.right_neighbour)
            for other in linked:
                if other is not None and other not in self.lanes:
                    raise ValueError(f"{where}: refers to lane {other!r}, which is not in the map")
        for i, outline in enumerate(self.drivable_area):
            checks.check_lines(f"HdMap.drivable_area[{i}]", outline, columns=2, least=3)
        for key, text in self.notes.items():
            checks.check_name("HdMap.notes", key)
            checks.check_text(f"HdMap.notes[{key!r}]", text)
        if self.ground is not None:
            self.ground.validate()


def drivable_region(hd_map: HdMap | None) -> shapely.Geometry | None:
    """Union of a map's drivable area and lanes, or None where there is neither."""
    if hd_map is None:
        return None
    outlines = [*hd_map.drivable_area, *(lane.polygon for lane in hd_map.lanes.values())]
    if not outlines:
        return None
    return shapely.union_all([shapely.make_valid(shapely.Polygon(o)) for o in outlines])


def without_holes(polygon: shapely.Polygon) -> list[shapely.Polygon]:
    """Pieces that together cover a polygon and have no holes: cut through every hole."""
    if not polygon.interiors:
        return [polygon]
    x = polygon.interiors[0].centroid.x
    low_x, low_y, high_x, high_y = polygon.bounds
    halves = (shapely.box(low_x, low_y, x, high_y), shapely.box(x, low_y, high_x, high_y))
    pieces = []
    for side in halves:
        cut = polygon.intersection(side)
        for part in getattr(cut, "geoms", [cut]):
            if isinstance(part, shapely.Polygon) and part.area > 0:
                pieces += without_holes(part)
    return pieces


VERSION = 1

Point2 = tuple[float, float]
Point3 = tuple[float, float, float]


_LINES = {"centreline": 3, "left_boundary": 3, "right_boundary": 3, "polygon": 2}
"""Lines of a lane, and numbers of a point."""


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
    """Write `hd_map` to `path`, whole or not at all; floats keep every digit. Raises ValueError:
    the map is not valid."""
    files.write_text(path, map_text(hd_map))


def map_text(hd_map: HdMap) -> str:
    """The content of a map.json. Raises ValueError: the map is not valid."""
    hd_map.validate()
    return _layout(_to_json(hd_map))


def read_map(path: str | Path) -> HdMap:
    """Read a map.json. Raises InputError: missing, not a map.json, of another version, or a field
    of the wrong kind."""
    return parse_map(path, files.read_json(path))


def parse_map(where: str | Path, value: Any) -> HdMap:
    """The map of a map.json's JSON data, which was read from `where`. Raises InputError: no
    map.json, of another version, or a field of the wrong kind."""
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
