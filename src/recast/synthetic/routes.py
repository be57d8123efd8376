"""Chains of lanes through a street."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from recast.geometry import se2
from recast.logs import HdMap
from recast.synthetic.lane_path import LanePath

Side = Literal["left", "right"]

_MAX_LANES = 50


def extended_route(street_map: HdMap, route: Sequence[str]) -> tuple[str, ...]:
    """A route with all the road before and after it, straight on where the road forks."""
    lanes = list(route)
    while len(lanes) < _MAX_LANES:
        ahead = [k for k in street_map.lanes[lanes[-1]].successors if k not in lanes]
        if not ahead:
            break
        lanes.append(min(ahead, key=lambda key: (_turn(street_map, key), key)))
    while len(lanes) < _MAX_LANES:
        behind = sorted(
            key
            for key, lane in street_map.lanes.items()
            if lanes[0] in lane.successors and key not in lanes
        )
        if not behind:
            break
        lanes.insert(0, min(behind, key=lambda key: (_turn(street_map, key), key)))
    return tuple(lanes)


def random_route(
    street_map: HdMap, first: str, least_length: float, rng: np.random.Generator
) -> tuple[str, ...]:
    """A chain from `first`, with a random choice at forks, until it has the length or ends."""
    lanes, length = [first], _length(street_map, first)
    while length < least_length and len(lanes) < _MAX_LANES:
        ahead = sorted(k for k in street_map.lanes[lanes[-1]].successors if k not in lanes)
        if not ahead:
            break
        lanes.append(ahead[int(rng.integers(len(ahead)))])
        length += _length(street_map, lanes[-1])
    return tuple(lanes)


def beside(street_map: HdMap, route: Sequence[str], side: Side) -> tuple[str, ...] | None:
    """The chain of lanes next to a part of `route`, or None where there is none.

    Where the neighbour begins or ends along the route, the longest unbroken piece is taken.
    """
    best: list[str] = []
    piece: list[str] = []
    for key in route:
        lane = street_map.lanes[key]
        neighbour = lane.left_neighbour if side == "left" else lane.right_neighbour
        if neighbour is None:
            piece = []
            continue
        if piece and neighbour == piece[-1]:
            continue
        follows = bool(piece) and neighbour in street_map.lanes[piece[-1]].successors
        piece = [*piece, neighbour] if follows else [neighbour]
        if _total(street_map, piece) > _total(street_map, best):
            best = piece
    return tuple(best) or None


def _total(street_map: HdMap, lanes: Sequence[str]) -> float:
    return sum(_length(street_map, key) for key in lanes)


def _length(street_map: HdMap, lane: str) -> float:
    steps = np.diff(street_map.lanes[lane].centreline[:, :2], axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())


def _turn(street_map: HdMap, lane: str) -> float:
    """How much a lane bends from its start to its end, radians, to the nearest degree."""
    path = LanePath.along(street_map, [lane])
    turn = se2.wrap_angle(path.heading(path.length) - path.heading(0.0))
    return round(abs(float(np.rad2deg(turn))))
