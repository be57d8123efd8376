"""A map made from the drive itself, for logs that come without one.

The ego drove on a lane: its path is the centreline. LiDAR tells how wide the road is, where its
edges are and how high the ground lies. Marked as derived: it is evidence, not a survey.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.polygon import orient

from recast.core.errors import InputError
from recast.geometry import Polyline, se3
from recast.logs.ground import (
    CELL,
    Grid,
    GroundGrid,
    ground_grid,
    ground_points,
    height_map,
    low_points,
    surface_of,
)
from recast.logs.hdmap import GroundHeight, HdMap, Lane, without_holes
from recast.logs.types import Array, DrivingLog, Trajectory

SPACING = 1.0  # metres between points of a centreline
HALF_LANE = 1.75  # metres, where nothing narrower is seen
NARROWEST_HALF = 1.3
NARROWEST_LANE, WIDEST_LANE = 2.6, 3.75  # metres, of neighbouring lanes
SHORTEST_LANE = 15.0  # metres of a neighbouring lane
SIDE_REACH = 9.0  # metres sideways in which road edges are looked for
EDGE_QUANTILE = 0.1  # of the room seen along a lane: a few odd cells do not narrow it
EGO_FRONT, EGO_REAR, EGO_HALF_WIDTH = 3.9, 1.0, 1.0  # metres from the rear axle


def map_of(log: DrivingLog) -> HdMap:
    """The log's map, or one derived from the drive where it came without.

    Raises:
        InputError: the log has no map and its ego never drives, so none can be derived.
    """
    return derive_map(log) if log.map is None else log.map


def derive_map(log: DrivingLog) -> HdMap:
    """Lanes, drivable area and ground height of a drive, in its world frame.

    - "ego": a lane along the recorded path, no longer than it. Its half widths are 1.75 m, less
      where a road edge is nearer.
    - "left", "right": neighbours, where the road is wide enough over at least 15 m and no tracked
      vehicle drives there the other way.
    - drivable area: ground one can reach without crossing a kerb, and wherever the ego was.

    Raises:
        InputError: the ego moves less than 2 m, so there is no path.
    """
    path = ego_path(log.world_from_rig)
    if path is None:
        raise InputError(
            log.name,
            "ego trajectory",
            "moves less than 2 m, so no map can be derived from it",
            "choose a drive in which the ego moves, or a log with a map",
        )
    grid = ground_grid(ground_points(low_points(log), path), path)
    surface = surface_of(grid, path)
    ground = height_map(grid, path)
    line = Polyline.from_points(path)
    room = {side: _room(line, grid, surface, side) for side in (1, -1)}
    lanes = _lanes(log, line, path, ground, room)
    area = _drivable_area(grid, surface, log.world_from_rig)
    return HdMap(
        lanes={lane.lane_id: lane for lane in lanes},
        drivable_area=area,
        ground=ground,
        derived=True,
        notes={
            "lanes": "centreline is the recorded ego path; widths from LiDAR road edges",
            "drivable_area": "smooth LiDAR ground reached from the path without a kerb",
            "ground": f"low LiDAR points in cells of {CELL} m, smoothed",
        },
    )


def ego_path(world_from_rig: Trajectory) -> Array | None:
    """Ego positions (P, 3) every metre from first to last, or None where it moves less than 2 m."""
    places = world_from_rig.poses[:, :3, 3]
    kept = [0]
    for i in range(1, len(places)):
        # A standing car's poses wander by centimetres: that is no path.
        if np.linalg.norm(places[i, :2] - places[kept[-1], :2]) > 0.3:
            kept.append(i)
    places = places[kept]
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1))])
    if along[-1] < 2.0:
        return None
    stations = np.linspace(0.0, along[-1], int(np.ceil(along[-1] / SPACING)) + 1)
    return np.stack([np.interp(stations, along, places[:, k]) for k in range(3)], axis=-1)


def _room(line: Polyline, grid: GroundGrid, surface: Grid, side: int) -> Array:
    """Metres of road to the left (side 1) or right (-1) of every vertex of the path."""
    reach = np.arange(0.0, SIDE_REACH, CELL / 2)
    places = line.to_cartesian(line.arc_lengths[:, None], side * reach[None, :])
    rows, columns = grid.cells(places)
    off_road = ~surface[rows, columns]
    first = np.where(off_road.any(axis=1), off_road.argmax(axis=1), len(reach) - 1)
    return reach[first]


@dataclass(frozen=True)
class _Strip:
    """A lane beside the path: stretch [first, last] of its vertices, offsets to the left."""

    name: str
    first: int
    last: int
    right: float
    left: float


def _lanes(
    log: DrivingLog, line: Polyline, path: Array, ground: GroundHeight, room: dict[int, Array]
) -> list[Lane]:
    half = {
        side: float(np.clip(np.quantile(room[side], EDGE_QUANTILE), NARROWEST_HALF, HALF_LANE))
        for side in (1, -1)
    }
    strips = [_Strip("ego", 0, len(path) - 1, -half[-1], half[1])]
    offsets = _traffic_offsets(log, line)
    for name, side in (("left", 1), ("right", -1)):
        strip = _neighbour(name, side, half[side], room[side], offsets)
        if strip is not None:
            strips.append(strip)
    names = {strip.name for strip in strips}
    return [_lane(strip, line, path, ground, names) for strip in strips]


def _neighbour(
    name: str, side: int, inner: float, room: Array, offsets: NDArray[np.float64]
) -> _Strip | None:
    """A lane beyond `inner` metres on one side, where there is room for one."""
    wide = room - inner >= NARROWEST_LANE
    first, last = _longest_run(wide)
    if (last - first) * SPACING < SHORTEST_LANE:
        return None
    lateral, same_way = offsets[:, 0] * side, offsets[:, 1] > 0
    here = (lateral > inner) & (lateral < inner + WIDEST_LANE)
    if np.any(here & ~same_way) and not np.any(here & same_way):
        return None
    width = float(np.quantile(room[first : last + 1], EDGE_QUANTILE)) - inner
    if np.any(here):
        # Traffic drives in the middle of its lane.
        width = min(width, max(2 * (float(np.median(lateral[here])) - inner), NARROWEST_LANE))
    outer = inner + float(np.clip(width, NARROWEST_LANE, WIDEST_LANE))
    return _Strip(name, first, last, *sorted((side * inner, side * outer)))


def _longest_run(flags: Grid) -> tuple[int, int]:
    """First and last index of the longest run of True; (0, 0) without any."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    if len(edges) == 0:
        return 0, 0
    starts, ends = edges[::2], edges[1::2] - 1
    longest = int(np.argmax(ends - starts))
    return int(starts[longest]), int(ends[longest])


def _traffic_offsets(log: DrivingLog, line: Polyline) -> Array:
    """(T, 2) of moving vehicles beside the path: lateral offset, and 1 with or -1 against it."""
    rows = []
    for track in log.tracks.values():
        places = track.trajectory.poses[:, :2, 3]
        moved = places[-1] - places[0]
        if np.linalg.norm(moved) < 5.0 or track.category in ("pedestrian", "cyclist"):
            continue
        s, lateral = line.to_frenet(places)
        beside = (s > 0) & (s < line.length)
        if np.any(beside):
            heading = line.heading(np.median(s[beside]))
            way = np.sign(moved @ [np.cos(heading), np.sin(heading)])
            rows.append((np.median(lateral[beside]), way))
    return np.array(rows, np.float64).reshape(-1, 2)


def _lane(
    strip: _Strip, line: Polyline, path: Array, ground: GroundHeight, names: set[str]
) -> Lane:
    stations = line.arc_lengths[strip.first : strip.last + 1]
    heights = path[strip.first : strip.last + 1, 2]

    def offset(lateral: float) -> Array:
        xy = line.to_cartesian(stations, np.full(len(stations), lateral))
        z = ground.at(xy)
        return np.column_stack([xy, np.where(np.isfinite(z), z, heights)])

    left, right = offset(strip.left), offset(strip.right)
    order: list[str] = [name for name in ("left", "ego", "right") if name in names]
    place = order.index(strip.name)
    return Lane(
        lane_id=strip.name,
        centreline=offset((strip.left + strip.right) / 2 if strip.name != "ego" else 0.0),
        left_boundary=left,
        right_boundary=right,
        polygon=np.concatenate([right, left[::-1]])[:, :2],
        left_neighbour=order[place - 1] if place > 0 else None,
        right_neighbour=order[place + 1] if place + 1 < len(order) else None,
    )


def _drivable_area(
    grid: GroundGrid, surface: Grid, world_from_rig: Trajectory
) -> tuple[Array, ...]:
    """Outlines of the surface cells and of all ground under the ego, without holes."""
    rows, columns = np.nonzero(surface)
    # In whole cells neighbours share their edges exactly, in metres they would leave slits.
    counted = shapely.union_all(shapely.box(columns, rows, columns + 1, rows + 1))
    cells = shapely.transform(counted, lambda xy: grid.origin + CELL * (xy - 0.5))
    footprint = np.array(
        [
            [EGO_FRONT, EGO_HALF_WIDTH, 0.0],
            [-EGO_REAR, EGO_HALF_WIDTH, 0.0],
            [-EGO_REAR, -EGO_HALF_WIDTH, 0.0],
            [EGO_FRONT, -EGO_HALF_WIDTH, 0.0],
        ]
    )
    corners = se3.apply(world_from_rig.poses, footprint)[..., :2]
    pairs = np.concatenate([corners[:-1], corners[1:]], axis=1)
    swept = shapely.convex_hull(shapely.multipoints([shapely.points(pair) for pair in pairs]))
    merged = shapely.union_all([cells.simplify(CELL / 2).buffer(0), *swept])
    parts = [part for part in getattr(merged, "geoms", [merged]) if part.area > 1.0]
    return tuple(
        np.array(orient(piece).exterior.coords)[:-1]
        for part in parts
        for piece in without_holes(part)
    )
