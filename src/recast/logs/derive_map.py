"""The ground around the ego path, from LiDAR: a grid of heights, and which cells are smooth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree
from shapely.geometry.polygon import orient

from recast.core.errors import InputError
from recast.geometry import Polyline, se3
from recast.logs.hdmap import GroundHeight, HdMap, Lane, without_holes
from recast.logs.types import PEOPLE, Array, DrivingLog, Trajectory

CELL = 0.3  # metres
REACH = 15.0  # metres from the ego path
STRAY, STRAY_SLOPE = 0.4, 0.04  # metres off the path's height, and more by metre from it
MIN_POINTS = 4
LOW, HIGH = 0.2, 0.8  # quantiles of the heights in a cell: ground level, and how rough it is
ROUGHNESS = 0.10  # metres between them on smooth ground
STEP = 0.07  # metres across two cells: a road's crossfall is less, a kerb more
CAR_RADIUS = 0.9  # metres, half a car's width
CLOSING = 0.6  # metres, half the width of gaps in the evidence that are closed
LEAST_WEIGHT = 0.02  # of smoothing: less is the far tail of a known cell
FILL = 2.5  # metres over which heights are continued into cells without ground points

Grid = NDArray[np.bool_]


@dataclass(frozen=True)
class GroundGrid:
    """LiDAR evidence about the ground."""

    origin: Array  # (2,) world x, y of the centre of cell [0, 0]
    level: Array  # (rows along y, columns along x) ground level in metres, NaN without evidence
    smooth: Grid  # cells that are flat enough to drive on

    def cells(self, points: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns of the cells that hold points (..., 2), clipped to the grid."""
        index = np.rint((np.asarray(points)[..., :2] - self.origin) / CELL).astype(np.intp)
        rows, columns = self.level.shape
        return np.clip(index[..., 1], 0, rows - 1), np.clip(index[..., 0], 0, columns - 1)


def ground_grid(points: Array, path: Array, quantile: float = LOW) -> GroundGrid:
    """A grid of cells with what the points in each say.

    Args:
        points: (N, 3) world, as `ground_points` gathers them.
        path: (P, 3) ego positions on the ground, at most a metre or so apart.
        quantile: quantile of the heights in a cell that counts as its level.
    """
    origin = np.floor((path[:, :2].min(axis=0) - REACH) / CELL) * CELL
    shape = np.ceil((path[:, :2].max(axis=0) + REACH - origin) / CELL).astype(int)[::-1] + 1
    column, row = np.rint((points[:, :2] - origin) / CELL).astype(int).T
    cell = row * shape[1] + column
    # Complex numbers sort by their real parts, then the imaginary: in a third of lexsort's time.
    pairs = np.empty(len(points), np.complex128)
    pairs.real, pairs.imag = cell, points[:, 2]
    pairs.sort()
    height, cell = pairs.imag, pairs.real.astype(int)
    names, first, count = np.unique(cell, return_index=True, return_counts=True)
    low, middle, high = (
        height[first + (share * (count - 1)).astype(int)] for share in (LOW, quantile, HIGH)
    )
    enough = count >= MIN_POINTS
    level = np.full(shape, np.nan)
    level.ravel()[names[enough]] = middle[enough]
    smooth = np.zeros(shape, bool)
    smooth.ravel()[names[enough]] = (high - low < ROUGHNESS)[enough]
    return GroundGrid(origin, level, smooth)


def ground_points(clouds: Iterable[Array], path: Array) -> Array:
    """The points (N, 3) near the path and near its height, of clouds (M, 3), all in the world."""
    tree = cKDTree(path[:, :2])
    kept = [np.zeros((0, 3))]
    # Most points are told apart by their height or by the path's bounds, without a search.
    most = STRAY + STRAY_SLOPE * REACH
    low = np.append(path[:, :2].min(axis=0) - REACH, path[:, 2].min() - most)
    high = np.append(path[:, :2].max(axis=0) + REACH, path[:, 2].max() + most)
    for cloud in clouds:
        points = cloud[np.all((cloud >= low) & (cloud <= high), axis=1)]
        distance, nearest = tree.query(points[:, :2], distance_upper_bound=REACH)
        near = np.flatnonzero(np.isfinite(distance))
        above = points[near, 2] - path[nearest[near], 2]
        kept.append(points[near[np.abs(above) < STRAY + STRAY_SLOPE * distance[near]]])
    return np.concatenate(kept)


def low_points(log: DrivingLog) -> Iterator[Array]:
    """Points (M, 3) of each sweep, in the world, within 3 m of the height of the rig."""
    for lidar in log.lidars.values():
        for index in range(len(lidar.timestamps_us)):
            sweep = lidar.sweeps[index]
            low = sweep.points[np.abs(sweep.points[:, 2]) < 3.0]
            yield se3.apply(log.world_from_rig.at(sweep.timestamp_us), low)


def surface_of(grid: GroundGrid, path: Array) -> Grid:
    """Cells that a car on the path could drive to: smooth, without a kerb in between.

    A kerb is a step over two cells. The connection has to be as wide as a car, else a lowered
    kerb or a gap in the evidence would let the pavement in.
    """
    rows, columns = grid.cells(path)
    kerbs = _kerbs(grid.level)
    known = grid.smooth & ~kerbs
    known[rows, columns] = True
    known = _closed(known, kerbs)
    wide = ndimage.binary_erosion(known, _disk(CAR_RADIUS))
    wide[rows, columns] = True
    label, _ = ndimage.label(wide)
    core = np.isin(label, np.unique(label[rows, columns]))
    reached: Grid = ndimage.binary_dilation(core, _disk(CAR_RADIUS)) & known
    return ndimage.binary_fill_holes(reached)


def _closed(known: Grid, kerbs: Grid) -> Grid:
    """Known cells with the gaps between them, but for kerbs."""
    return ndimage.binary_closing(known, _disk(CLOSING), border_value=0) & ~kerbs


def _kerbs(level: Array) -> Grid:
    """Cells with a step across them."""
    filled = np.where(np.isfinite(level), level, np.nan)
    step = np.zeros(level.shape)
    across = np.abs(filled[:, 2:] - filled[:, :-2])
    along = np.abs(filled[2:, :] - filled[:-2, :])
    step[:, 1:-1] = np.fmax(step[:, 1:-1], across)
    step[1:-1, :] = np.fmax(step[1:-1, :], along)
    return step > STEP


def _disk(radius: float) -> Grid:
    reach = int(np.ceil(radius / CELL))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return np.hypot(x, y) * CELL <= radius


def height_map(grid: GroundGrid, path: Array) -> GroundHeight:
    """Ground heights: levels smoothed over about a metre and continued a little, in millimetres.

    Cells of the path without LiDAR points take its height: the car stood on them.
    """
    level = grid.level.copy()
    rows, columns = grid.cells(path)
    level[rows, columns] = np.where(
        np.isfinite(level[rows, columns]), level[rows, columns], path[:, 2]
    )
    known = np.isfinite(level)
    smoothed = _smoothed(level, known)
    distance, (near_row, near_column) = ndimage.distance_transform_edt(~known, return_indices=True)
    filled = np.where(distance * CELL <= FILL, smoothed[near_row, near_column], np.nan)
    return GroundHeight(grid.origin, CELL, np.round(filled, 3).astype(np.float64))


def even_ground(clouds: Iterable[Array], path: Array) -> GroundHeight:
    """Heights smoothed over about a metre where the ground is even, NaN elsewhere.

    Even is what is smooth and no kerb: road and pavement, each by itself, but not what stands on
    them. Gaps in the evidence of less than a metre are closed.

    Args:
        clouds: world points (M, 3) of sweeps, without what moves.
        path: (P, 3) ego positions on the ground, at most a metre or so apart.
    """
    grid = ground_grid(ground_points(clouds, path), path, 0.5)
    kerbs = _kerbs(grid.level)
    even = _closed(grid.smooth & ~kerbs, kerbs)
    seen = even & np.isfinite(grid.level)
    return GroundHeight(grid.origin, CELL, np.where(even, _smoothed(grid.level, seen), np.nan))


def _smoothed(level: Array, known: Grid) -> Array:
    """Gaussian mean of the known levels; NaN where there is none near."""
    sigma = 0.4 / CELL
    weight = ndimage.gaussian_filter(known.astype(float), sigma, mode="constant")
    total = ndimage.gaussian_filter(np.where(known, level, 0.0), sigma, mode="constant")
    return np.where(weight > LEAST_WEIGHT, total / np.maximum(weight, LEAST_WEIGHT), np.nan)


# A map made from the drive itself, for logs that come without one.
#
# The ego drove on a lane: its path is the centreline. LiDAR tells how wide the road is, where its
# edges are and how high the ground lies. Marked as derived: it is evidence, not a survey.

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
        if np.linalg.norm(moved) < 5.0 or track.category in (*PEOPLE, "motorcyclist"):
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
