"""Where a map says that one can drive."""

from __future__ import annotations

import shapely

from recast.logs.hdmap import HdMap


def drivable_region(hd_map: HdMap | None) -> shapely.Geometry | None:
    """Union of a map's drivable area and lanes, or None where there is neither."""
    if hd_map is None:
        return None
    outlines = [*hd_map.drivable_area, *(lane.polygon for lane in hd_map.lanes.values())]
    if not outlines:
        return None
    return shapely.union_all([shapely.make_valid(shapely.Polygon(o)) for o in outlines])
