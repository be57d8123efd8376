"""Argoverse 2 HD map: the vector map and the ground height raster of a log."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationError

from recast.core import files
from recast.core.array_files import read_npy
from recast.core.errors import InputError
from recast.core.records import validation_error
from recast.logs import checks
from recast.logs.hdmap import GroundHeight, HdMap, Lane
from recast.logs.importers.common import NEAR, ForeignRecord, lane_outline, metres_beside
from recast.logs.types import Array

_STEP = 1.0
"""Metres between points of an averaged centreline, measured on the longer boundary."""
_LONGEST = 20_000.0
"""Metres of a lane's boundary; those of the dataset have a few hundred at the most."""
_LARGEST_RASTER = 1 << 26
"""Bytes; those of the dataset have one or two million."""
_MEND = "download the log's map again"


_Metres = Annotated[float, Field(ge=-checks.WORLD_REACH, le=checks.WORLD_REACH)]


class _Point(ForeignRecord):
    x: _Metres
    y: _Metres
    z: _Metres


class _Lane(ForeignRecord):
    id: int
    is_intersection: bool
    lane_type: Literal["VEHICLE", "BUS", "BIKE"]
    left_lane_boundary: list[_Point]
    right_lane_boundary: list[_Point]
    successors: list[int]
    left_neighbor_id: int | None
    right_neighbor_id: int | None


class _Area(ForeignRecord):
    area_boundary: list[_Point]


class _Map(ForeignRecord):
    lane_segments: dict[str, _Lane]
    drivable_areas: dict[str, _Area]


class _Sim2(ForeignRecord):
    R: tuple[float, float, float, float]
    t: tuple[float, float]
    s: float


def find_map(log: Path) -> Path:
    """The vector map of a log.

    Raises:
        InputError: there is none.
    """
    path = _one(log / "map", "log_map_archive_*.json")
    if path is None:
        raise InputError(log / "map", "log_map_archive_*.json", "is missing", _MEND)
    return path


def city_of(path: Path) -> str:
    """The city in a vector map's name, such as "PIT"; empty where it has none."""
    found = re.search(r"____([A-Z]+)_city", path.name)
    return found[1] if found else ""


def read_map(log: Path, ego: Array, offset: Array) -> HdMap:
    """Lanes for cars, drivable area and ground height of a log, in its world frame.

    Bicycle lanes are left out, and neighbours of the other direction. Centrelines are not stored;
    they are the mean of both boundaries at equal shares of their lengths.

    Args:
        log: the log's folder.
        ego: (T, 2) positions of the ego, world frame.
        offset: (3,) city coordinates = world coordinates + offset.

    Raises:
        InputError: a file or field is missing or wrong, there is no lane for cars, or the map lies
            elsewhere than the drive.
    """
    path = find_map(log)
    try:
        model = _Map.model_validate(files.read_json(path))
    except ValidationError as error:
        raise validation_error(path, error, _MEND) from None
    driven = {
        str(lane.id): lane for lane in model.lane_segments.values() if lane.lane_type != "BIKE"
    }
    if not driven:
        raise InputError(path, "lane_segments", "contains no lane for cars", _MEND)
    lines = {
        key: tuple(
            _line(path, f"lane_segments.{key}.{side}_lane_boundary", points, offset)
            for side, points in (
                ("left", lane.left_lane_boundary),
                ("right", lane.right_lane_boundary),
            )
        )
        for key, lane in driven.items()
    }
    lanes = {key: _lane(key, driven, lines) for key in driven}
    _check_place(path, lanes, ego)
    areas = []
    for name, area in model.drivable_areas.items():
        outline = _coordinates(area.area_boundary, offset)[:, :2]
        if len(outline) < 3:
            field = f"drivable_areas.{name}.area_boundary"
            raise InputError(path, field, f"has {len(outline)} points, 3 are needed", _MEND)
        areas.append(outline)
    city = city_of(path)
    return HdMap(
        lanes=lanes,
        drivable_area=tuple(areas),
        ground=_read_ground(log / "map", offset),
        notes={"source": "Argoverse 2", **({"city": city} if city else {})},
    )


def _one(folder: Path, pattern: str) -> Path | None:
    return next(iter(sorted(folder.glob(pattern))), None)


def _coordinates(points: list[_Point], offset: Array) -> Array:
    return np.array([(p.x, p.y, p.z) for p in points], np.float64).reshape(-1, 3) - offset


def _line(path: Path, field: str, points: list[_Point], offset: Array) -> Array:
    line = _coordinates(points, offset)
    if len(line) < 2 or not np.any(np.ptp(line[:, :2], axis=0) > 0):
        raise InputError(path, field, "has fewer than two distinct points", _MEND)
    length = float(np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1).sum())
    if length > _LONGEST:  # it is resampled every metre
        raise InputError(
            path, field, f"is {length:.0f} m long, longer than {_LONGEST:.0f} m", _MEND
        )
    return line


def _lane(key: str, lanes: dict[str, _Lane], lines: dict[str, tuple[Array, ...]]) -> Lane:
    lane, (left, right) = lanes[key], lines[key]
    centre = _mean_line(left, right)

    def same_way(other: int | None) -> str | None:
        if other is None or str(other) not in lanes:
            return None
        theirs = _mean_line(*lines[str(other)])
        along = (centre[-1] - centre[0])[:2] @ (theirs[-1] - theirs[0])[:2]
        return str(other) if along > 0 else None

    return Lane(
        lane_id=key,
        centreline=centre,
        left_boundary=left,
        right_boundary=right,
        polygon=lane_outline(left, right),
        successors=tuple(str(other) for other in lane.successors if str(other) in lanes),
        left_neighbour=same_way(lane.left_neighbor_id),
        right_neighbour=same_way(lane.right_neighbor_id),
        is_intersection=lane.is_intersection,
    )


def _mean_line(left: Array, right: Array) -> Array:
    """Points (N, 3) midway between two lines, at equal shares of their lengths."""
    steps = [np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1) for line in (left, right)]
    lengths = [np.concatenate([[0.0], np.cumsum(step)]) for step in steps]
    longest = max(length[-1] for length in lengths)
    share = np.linspace(0.0, 1.0, int(np.ceil(longest / _STEP)) + 1)
    sides = [
        np.stack([np.interp(share * length[-1], length, line[:, k]) for k in range(3)], axis=-1)
        for line, length in zip((left, right), lengths, strict=True)
    ]
    return (sides[0] + sides[1]) / 2


def _check_place(path: Path, lanes: dict[str, Lane], ego: Array) -> None:
    distance = metres_beside(lanes, ego)
    if distance > NEAR:
        raise InputError(
            path,
            "lane_segments",
            f"the ego drives {distance:.0f} m away from all lanes: the map is of another log, or "
            "in other coordinates",
            "use the map and the poses of the same log, both in city coordinates",
        )


def _read_ground(folder: Path, offset: Array) -> GroundHeight | None:
    """The ground raster, or None where the log has none."""
    raster, placing = (
        _one(folder, pattern)
        for pattern in ("*_ground_height_surface____*.npy", "*___img_Sim2_city.json")
    )
    if raster is None and placing is None:
        return None
    if raster is None or placing is None:
        missing = "*_ground_height_surface____*.npy" if raster is None else "*___img_Sim2_city.json"
        raise InputError(folder, missing, "is missing", _MEND)
    height = read_npy(raster, _MEND, _LARGEST_RASTER)
    if height.ndim != 2 or not np.issubdtype(height.dtype, np.floating) or not height.size:
        problem = f"is {height.dtype} of shape {height.shape}, not two-dimensional numbers"
        raise InputError(raster, "array", problem, _MEND)
    try:
        sim2 = _Sim2.model_validate(files.read_json(placing))
    except ValidationError as error:
        raise validation_error(placing, error, _MEND) from None
    if not np.allclose(sim2.R, (1.0, 0.0, 0.0, 1.0), atol=1e-9) or sim2.s <= 0:
        problem = (
            f"a raster turned by {json.dumps(sim2.R)} or scaled by {sim2.s:g} is not supported"
        )
        raise InputError(placing, "R, s", problem, _MEND)
    # A place p of the city lies in cell floor(s (p + t)), so the first centre is at 0.5 / s - t.
    cell = 1.0 / sim2.s
    above = np.where(np.isfinite(height), height, np.nan).astype(np.float64) - offset[2]
    return GroundHeight(
        origin=cell / 2 - np.array(sim2.t) - offset[:2],
        cell=cell,
        height=np.round(above, 3),  # half floats come in steps of centimetres
    )
