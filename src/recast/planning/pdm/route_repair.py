"""Mending a route: missing blocks at its start and within, and loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import shapely

from recast.planning.map import Block, PlannerMap

_BACKWARD_DEPTH = 15
_FORWARD_DEPTH = 30
_REJOIN = 3
"""Of how many first blocks one must be reached when none leads back to the start."""
_LOOP_AREA = 1.0
"""Square metres that two connectors of a route may share before it counts as a loop."""


def repair_route(planner_map: PlannerMap, route: Sequence[str], start: str | None) -> list[str]:
    """Blocks of a route that begins where the ego is and has neither gaps nor loops, if possible.

    - Where the ego's block is not on it, the blocks from there to its first one are put in front;
      failing that, those to one of its first three, which then becomes the first.
    - Between two blocks that do not follow on each other, those in between are put in.
    - It ends before a connector that overlaps one of an earlier intersection by more than 1 m^2.

    Source: tuplan_garage's route correction. There an intersection is crossed on one connector;
    here connectors may follow on each other, and overlap where they do.

    Args:
        route: block ids in order, at least one.
        start: the ego's block, or None where it is on none.
    """
    blocks = planner_map.blocks
    mended = list(dict.fromkeys(route))
    if start is not None and start not in mended:
        mended = _from_start(blocks, mended, start)
    filled = mended[:1]
    for here, following in pairwise(mended):
        between = _search(blocks, here, {following}, _FORWARD_DEPTH)
        filled += [following] if between is None else between[1:]
    return _without_loops(planner_map, list(dict.fromkeys(filled)))


def _from_start(blocks: Mapping[str, Block], route: list[str], start: str) -> list[str]:
    back = _search(blocks, route[0], {start}, _BACKWARD_DEPTH, backward=True)
    if back is not None:
        return back[:0:-1] + route
    ahead = _search(blocks, start, set(route[:_REJOIN]), _FORWARD_DEPTH)
    if ahead is None:
        return route
    return ahead + route[route.index(ahead[-1]) + 1 :]


def _search(
    blocks: Mapping[str, Block], start: str, goals: set[str], depth: int, *, backward: bool = False
) -> list[str] | None:
    """Shortest chain of at most `depth` blocks from start to a goal, both included, or None."""
    came_from = {start: ""}
    layer = [start]
    for _ in range(depth - 1):
        reached: list[str] = []
        for key in layer:
            for other in blocks[key].predecessors if backward else blocks[key].successors:
                if other in came_from:
                    continue
                came_from[other] = key
                if other in goals:
                    chain = [other]
                    while came_from[chain[-1]]:
                        chain.append(came_from[chain[-1]])
                    return chain[::-1]
                reached.append(other)
        layer = reached
    return None


def _without_loops(planner_map: PlannerMap, route: list[str]) -> list[str]:
    earlier: list[shapely.Geometry] = []
    here: list[shapely.Geometry] = []
    for i, key in enumerate(route):
        block = planner_map.blocks[key]
        if not block.connector:
            earlier, here = earlier + here, []
            continue
        area = shapely.union_all([planner_map.lanes[lane].polygon for lane in block.lane_ids])
        if any(shapely.area(shapely.intersection(area, old)) > _LOOP_AREA for old in earlier):
            return route[:i]
        here.append(area)
    return route
