"""The map under a bird's-eye picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.logs.hdmap import HdMap
from recast.reporting import palette
from recast.reporting.canvas import Canvas, dashed

Array = NDArray[np.float64]


class MapLayer:
    """A map made ready to be drawn many times: what lies outside of the view costs nothing.

    Args:
        hd_map: lanes and drivable area; None draws the grid alone.
    """

    def __init__(self, hd_map: HdMap | None) -> None:
        lanes = [] if hd_map is None else list(hd_map.lanes.values())
        outlines = [] if hd_map is None else list(hd_map.drivable_area)
        self._areas = _Shapes.of([*outlines, *(lane.polygon for lane in lanes)])
        self._centrelines = _Shapes.of(
            [piece for lane in lanes for piece in dashed(lane.centreline, 1.5)]
        )
        self._boundaries = _Shapes.of(
            [
                line
                for lane in lanes
                if not lane.is_intersection
                for line in (lane.left_boundary, lane.right_boundary)
            ]
        )

    def draw(self, canvas: Canvas) -> None:
        """Draw a ten-metre grid, the drivable area, and the lanes."""
        low, high = canvas.view.footprint.min(axis=0), canvas.view.footprint.max(axis=0)
        columns = np.arange(np.ceil(low[0] / 10) * 10, high[0], 10.0)
        rows = np.arange(np.ceil(low[1] / 10) * 10, high[1], 10.0)
        grid = [np.array([[x, low[1]], [x, high[1]]]) for x in columns]
        grid += [np.array([[low[0], y], [high[0], y]]) for y in rows]
        canvas.lines(grid, palette.GRID)
        for outline in self._areas.within(low, high):
            canvas.polygon(outline, palette.DRIVABLE)
        canvas.lines(self._centrelines.within(low, high), palette.CENTRELINE)
        canvas.lines(self._boundaries.within(low, high), palette.BOUNDARY)


@dataclass(frozen=True)
class _Shapes:
    """Chains of points (N_i, 2) with their bounds `low`, `high` (M, 2)."""

    chains: tuple[Array, ...]
    low: Array
    high: Array

    @classmethod
    def of(cls, chains: Sequence[Array]) -> _Shapes:
        flat = tuple(np.asarray(chain, np.float64)[:, :2] for chain in chains)
        low = np.array([chain.min(axis=0) for chain in flat]).reshape(-1, 2)
        high = np.array([chain.max(axis=0) for chain in flat]).reshape(-1, 2)
        return cls(flat, low, high)

    def within(self, low: Array, high: Array) -> list[Array]:
        """Those whose bounds meet the rectangle."""
        meets = np.all((self.low <= high) & (self.high >= low), axis=1)
        return [self.chains[i] for i in np.flatnonzero(meets)]
