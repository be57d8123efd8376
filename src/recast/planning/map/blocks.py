"""Grouping lanes into blocks: same-direction neighbours, and connectors between two blocks."""

from __future__ import annotations

from collections.abc import Mapping

from recast.logs.hdmap import Lane


def group_lanes(lanes: Mapping[str, Lane]) -> dict[str, str]:
    """Block id of each lane, by lane id; a block is named after its first lane in map order.

    Outside intersections a block is a connected component of same-direction neighbours. Inside,
    lanes share a block when they come from the same blocks and lead to the same blocks, those at
    the ends of the intersection and those directly before and after, as many lanes into it. A
    connector that is joined to nothing outside is a block of its own.
    """
    block = _neighbour_components(lanes)
    before: dict[str, list[str]] = {key: [] for key in lanes}
    for key, lane in lanes.items():
        for other in lane.successors:
            before[other].append(key)
    after = {key: list(lane.successors) for key, lane in lanes.items()}

    signatures: dict[str, object] = {}
    for key in (key for key, lane in lanes.items() if lane.is_intersection):
        sources, depth = _roads(key, before, lanes, block)
        targets, _ = _roads(key, after, lanes, block)
        signatures[key] = (sources, targets, depth) if sources or targets else key
    grouped = _named(signatures)
    # On a ring every lane comes from and leads to every road: only its direct neighbours tell
    # where on the ring it is.
    while True:
        every = {**block, **grouped}
        finer = _named(
            {
                key: (
                    grouped[key],
                    frozenset(every[other] for other in before[key]),
                    frozenset(every[other] for other in after[key]),
                )
                for key in grouped
            }
        )
        if finer == grouped:
            return every
        grouped = finer


def _named(signatures: Mapping[str, object]) -> dict[str, str]:
    """For each key the first key with the same signature."""
    first: dict[object, str] = {}
    return {key: first.setdefault(signature, key) for key, signature in signatures.items()}


def _neighbour_components(lanes: Mapping[str, Lane]) -> dict[str, str]:
    links: dict[str, set[str]] = {k: set() for k, lane in lanes.items() if not lane.is_intersection}
    for key in links:
        for other in (lanes[key].left_neighbour, lanes[key].right_neighbour):
            # A link that only one side states counts: surveys are not always symmetric.
            if other is not None and other in links:
                links[key].add(other)
                links[other].add(key)
    block: dict[str, str] = {}
    for key in links:
        open_lanes = [key] if key not in block else []
        while open_lanes:
            lane = open_lanes.pop()
            block[lane] = key
            open_lanes += [other for other in links[lane] if other not in block]
    return block


def _roads(
    start: str, links: Mapping[str, list[str]], lanes: Mapping[str, Lane], block: Mapping[str, str]
) -> tuple[frozenset[str], int]:
    """Blocks outside the intersection reached through connectors, and how many connectors away."""
    found: set[str] = set()
    nearest = len(lanes)
    seen, layer, depth = {start}, [start], 0
    while layer:
        reached: list[str] = []
        for lane in layer:
            for other in links[lane]:
                if not lanes[other].is_intersection:
                    found.add(block[other])
                    nearest = min(nearest, depth)
                elif other not in seen:
                    seen.add(other)
                    reached.append(other)
        layer, depth = reached, depth + 1
    return frozenset(found), nearest
