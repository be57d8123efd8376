"""The map under a bird's-eye picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.logs.hdmap import HdMap
from recast.reporting import palette
from recast.reporting.canvas import Canvas

Array = NDArray[np.float64]


def draw_map(canvas: Canvas, hd_map: HdMap | None) -> None:
    """Draw a ten-metre grid, and the map's drivable area and lanes where they meet the view."""
    low, high = canvas.view.footprint.min(axis=0), canvas.view.footprint.max(axis=0)
    for x in np.arange(np.ceil(low[0] / 10) * 10, high[0], 10.0):
        canvas.line([[x, low[1]], [x, high[1]]], palette.GRID)
    for y in np.arange(np.ceil(low[1] / 10) * 10, high[1], 10.0):
        canvas.line([[low[0], y], [high[0], y]], palette.GRID)
    if hd_map is None:
        return

    def in_view(points: Array) -> bool:
        return bool(
            np.all(points[:, :2].min(axis=0) <= high) and np.all(points[:, :2].max(axis=0) >= low)
        )

    for outline in filter(in_view, hd_map.drivable_area):
        canvas.polygon(outline, palette.DRIVABLE)
    lanes = [lane for lane in hd_map.lanes.values() if in_view(lane.polygon)]
    for lane in lanes:
        canvas.polygon(lane.polygon, palette.DRIVABLE)
    for lane in lanes:
        canvas.dashes(lane.centreline, palette.CENTRELINE)
        if not lane.is_intersection:
            canvas.line(lane.left_boundary, palette.BOUNDARY)
            canvas.line(lane.right_boundary, palette.BOUNDARY)
