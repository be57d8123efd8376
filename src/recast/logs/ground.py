"""The ground around the ego path, from LiDAR: a grid of heights, and which cells are smooth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from recast.geometry import se3
from recast.logs.hdmap import GroundHeight
from recast.logs.types import Array, DrivingLog

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
    """LiDAR evidence about the ground.

    Attributes:
        origin: (2,) world x, y of the centre of cell [0, 0].
        level: (rows along y, columns along x) ground level in metres, NaN without evidence.
        smooth: cells that are flat enough to drive on.
    """

    origin: Array
    level: Array
    smooth: Grid

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
