"""How lanes become roads, and how roads that part and join become junctions of OpenDRIVE.

Neighbours of one direction are lanes of one road if they share a boundary and end along one line.
A road leads to one road or into a junction, in which connecting roads lead from incoming roads to
outgoing ones. Roads between which others part or join become connecting roads; those that share an
incoming or an outgoing road lie in one junction. A road can be one if it has one predecessor and at
most one successor, none of which is to be a connecting road itself.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from recast.arrays import Array
from recast.logs.hdmap import Lane
from recast_bridges.openx.reference_line import beside

_SHARED = 0.01
"""Metres between the boundaries that neighbours share."""
_IN_LINE = 0.04
"""Metres from a corner to the line through the road's outer corners."""
_GAP = 0.008
"""Metres between corners of connected lanes; ASAM's checker calls more than 0.01 a gap."""


class End(NamedTuple):
    """What a road begins or ends at: a road, or a junction, by its number."""

    road: int | None
    junction: int | None


@dataclass(frozen=True)
class LaneNetwork:
    """Roads and their links. Roads and junctions have numbers from 0, each kind for itself."""

    roads: tuple[tuple[str, ...], ...]  # lanes of each road, from left to right
    # before, after: what a road begins and ends at, if anything.
    before: Mapping[int, End]
    after: Mapping[int, End]
    junction: Mapping[int, int]  # number of the junction that a connecting road lies in
    # incoming and connecting road, by junction.
    connections: Mapping[int, tuple[tuple[int, int], ...]]
    left_out: int  # links between lanes that the format cannot express
    parted: int  # neighbours that are not in one road


def network(lanes: Mapping[str, Lane]) -> LaneNetwork:
    """The roads of a map, and their links as roads and junctions."""
    rows = roads = _beside_each_other(lanes)
    least = _linked(lanes, [(key,) for key in lanes])[0].left_out
    while gaps := {road for pair in _gaps(lanes, roads) for road in pair if len(roads[road]) > 1}:
        roads = _split(roads, gaps)
    found, lost = _linked(lanes, roads)
    while found.left_out > least:
        # Lanes of a road must lead on together: where they do not, they are roads of their own.
        broken = {road for pair in lost for road in pair if len(roads[road]) > 1}
        if not broken:
            break
        tries = [_split(roads, {road}) for road in sorted(broken)]
        counts = [_linked(lanes, one)[0].left_out for one in tries]
        best = min(counts)
        better = best < found.left_out
        roads = tries[counts.index(best)] if better else _split(roads, broken)
        found, lost = _linked(lanes, roads)
    # Some were split only because of others.
    for row in rows:
        whole = [road for road in roads if road[0] not in row]
        if len(row) < 2 or len(whole) + 1 == len(roads):
            continue
        whole.append(row)
        again, _ = _linked(lanes, whole)
        if again.left_out <= found.left_out and not _gaps(lanes, whole):
            roads, found = whole, again
    return found


def _split(roads: Sequence[tuple[str, ...]], broken: set[int]) -> list[tuple[str, ...]]:
    """Roads, those of the given numbers split into their lanes."""
    return [
        part
        for i, road in enumerate(roads)
        for part in ([(key,) for key in road] if i in broken else [road])
    ]


def _beside_each_other(lanes: Mapping[str, Lane]) -> list[tuple[str, ...]]:
    """Lanes of each road, in the order of the map."""
    right = {
        key: lane.right_neighbour
        for key, lane in lanes.items()
        if lane.right_neighbour is not None
        and lanes[lane.right_neighbour].left_neighbour == key
        and _share_a_boundary(lane, lanes[lane.right_neighbour])
    }
    left = {other: key for key, other in right.items()}
    roads: list[tuple[str, ...]] = []
    placed: set[str] = set()
    for key in lanes:
        chain = [key]
        while chain[0] in left and left[chain[0]] not in (*chain, *placed):
            chain.insert(0, left[chain[0]])
        for name in chain if key not in placed else ():
            row = [name]
            while name not in placed and row[-1] in right:
                longer = [*row, right[row[-1]]]
                if longer[-1] in (*row, *placed) or not _in_line([lanes[one] for one in longer]):
                    break
                row = longer
            if name not in placed:
                roads.append(tuple(row))
                placed.update(row)
    return roads


def _share_a_boundary(left: Lane, right: Lane) -> bool:
    one, other = left.right_boundary[:, :2], right.left_boundary[:, :2]
    ends = np.linalg.norm(one[[0, -1]] - other[[0, -1]], axis=1)
    return bool(
        ends.max() <= _SHARED
        and beside(one, other).max() <= _SHARED
        and beside(other, one).max() <= _SHARED
    )


def _corners(row: Sequence[Lane], end: int) -> tuple[Array, Array]:
    """Corners (N + 1, 2) of lanes beside each other at an end, 0 or -1; and the points next to them
    on the line through the outer ones, where a road's cross section has them."""
    points = np.array([row[0].left_boundary[end, :2], *(r.right_boundary[end, :2] for r in row)])
    across = points[-1] - points[0]
    share = (points - points[0]) @ across / max(float(across @ across), 1e-12)
    return points, points[0] + share[:, None] * across


def _in_line(row: Sequence[Lane]) -> bool:
    """Whether the corners of lanes beside each other lie on one line at either end."""
    ends = [_corners(row, end) for end in (0, -1)]
    return all(np.linalg.norm(own - line, axis=1).max() <= _IN_LINE for own, line in ends)


def _gaps(lanes: Mapping[str, Lane], roads: Sequence[tuple[str, ...]]) -> list[tuple[int, int]]:
    """Pairs of roads whose connected lanes would not meet, because they are put in line."""
    place = {key: (i, j) for i, road in enumerate(roads) for j, key in enumerate(road)}
    rows = [[lanes[key] for key in road] for road in roads]
    first, last = ([_corners(row, end) for row in rows] for end in (0, -1))
    gaps = []
    for key, lane in lanes.items():
        for other in lane.successors:
            (i, j), (k, m) = place[key], place[other]
            moved = [line - own for own, line in (last[i], first[k])]
            apart = np.linalg.norm(moved[0][j : j + 2] - moved[1][m : m + 2], axis=1)
            if apart.max() > _GAP:
                gaps.append((i, k))
    return gaps


def _linked(
    lanes: Mapping[str, Lane], roads: Sequence[tuple[str, ...]]
) -> tuple[LaneNetwork, list[tuple[int, int]]]:
    """Links of roads, and the pairs of roads whose link was left out."""
    road_of = {key: i for i, road in enumerate(roads) for key in road}
    of_lanes = [
        (road_of[key], road_of[other]) for key, lane in lanes.items() for other in lane.successors
    ]
    links = list(dict.fromkeys(of_lanes))
    ahead, behind = defaultdict(list), defaultdict(list)
    for first, second in links:
        ahead[first].append(second)
        behind[second].append(first)
    branching = {
        road for ends in (*ahead.values(), *behind.values()) if len(ends) > 1 for road in ends
    }
    connecting = [
        road
        for road in range(len(roads))
        if road in branching
        and len(behind[road]) == 1
        and len(ahead[road]) <= 1
        and branching.isdisjoint((*behind[road], *ahead[road]))
    ]
    # A road that comes in is another end than the same road where it goes out.
    ends = {
        road: (f"<{behind[road][0]}", *(f">{other}" for other in ahead[road]))
        for road in connecting
    }
    junction = _grouped(ends)
    before: dict[int, End] = {}
    after: dict[int, End] = {}
    lost = []
    for first, second in links:
        plain = len(ahead[first]) == 1 and len(behind[second]) == 1
        if second in junction:
            after[first], before[second] = End(None, junction[second]), End(first, None)
        elif first in junction:
            after[first], before[second] = End(second, None), End(None, junction[first])
        elif plain:
            after[first], before[second] = End(second, None), End(first, None)
        else:
            lost.append((first, second))
    connections: dict[int, tuple[tuple[int, int], ...]] = {}
    for road, number in junction.items():
        connections[number] = (*connections.get(number, ()), (behind[road][0], road))
    parted = sum(
        other is not None and road_of[other] != road_of[key]
        for key, lane in lanes.items()
        for other in (lane.right_neighbour,)
    )
    left_out = sum(pair in lost for pair in of_lanes)
    told = LaneNetwork(tuple(roads), before, after, junction, connections, left_out, parted)
    return told, lost


def _grouped(ends: Mapping[int, tuple[str, ...]]) -> dict[int, int]:
    """Numbers of groups that share an end, directly or through others."""
    groups: list[set[str]] = []  # of ends
    for names in ends.values():
        touched = [group for group in groups if not group.isdisjoint(names)]
        groups = [group for group in groups if group not in touched]
        groups.append(set(names).union(*touched))
    return {
        key: next(i for i, g in enumerate(groups) if names[0] in g) for key, names in ends.items()
    }
