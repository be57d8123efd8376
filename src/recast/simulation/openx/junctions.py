"""How lanes that part and join become roads and junctions of OpenDRIVE.

A road leads to one road or into a junction, in which connecting roads lead from incoming roads to
outgoing ones. Lanes between which others part or join become connecting roads; those that share an
incoming or an outgoing road lie in one junction. A lane can be one if it has one predecessor and at
most one successor, none of which is to be a connecting road itself.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from recast.logs.hdmap import Lane


class End(NamedTuple):
    """What a road begins or ends at: a lane, or a junction by its number."""

    lane: str | None
    junction: int | None


@dataclass(frozen=True)
class Network:
    """Links of roads.

    Attributes:
        before, after: what a lane's road begins and ends at, if anything.
        junction: number of the junction that a connecting road lies in, by lane.
        connections: incoming and connecting lane, by junction.
        left_out: links that the format cannot tell so.
    """

    before: Mapping[str, End]
    after: Mapping[str, End]
    junction: Mapping[str, int]
    connections: Mapping[int, tuple[tuple[str, str], ...]]
    left_out: int


def network(lanes: Mapping[str, Lane]) -> Network:
    """The links between lanes, as roads and junctions."""
    links = [(key, other) for key, lane in lanes.items() for other in lane.successors]
    ahead, behind = defaultdict(list), defaultdict(list)
    for first, second in links:
        ahead[first].append(second)
        behind[second].append(first)
    branching = {
        one for ends in (*ahead.values(), *behind.values()) if len(ends) > 1 for one in ends
    }
    connecting = [
        key
        for key in lanes
        if key in branching
        and len(behind[key]) == 1
        and len(ahead[key]) <= 1
        and branching.isdisjoint((*behind[key], *ahead[key]))
    ]
    # A lane that comes in is another end than the same lane where it goes out.
    ends = {key: (f"<{behind[key][0]}", *(f">{one}" for one in ahead[key])) for key in connecting}
    junction = _grouped(ends)
    before: dict[str, End] = {}
    after: dict[str, End] = {}
    left_out = 0
    for first, second in links:
        plain = len(ahead[first]) == 1 and len(behind[second]) == 1
        if second in junction:
            after[first], before[second] = End(None, junction[second]), End(first, None)
        elif first in junction:
            after[first], before[second] = End(second, None), End(None, junction[first])
        elif plain:
            after[first], before[second] = End(second, None), End(first, None)
        else:
            left_out += 1
    connections: dict[int, tuple[tuple[str, str], ...]] = {}
    for key, number in junction.items():
        connections[number] = (*connections.get(number, ()), (behind[key][0], key))
    return Network(before, after, junction, connections, left_out)


def _grouped(ends: Mapping[str, tuple[str, ...]]) -> dict[str, int]:
    """Numbers of groups that share an end, directly or through others."""
    groups: list[set[str]] = []  # of ends
    for names in ends.values():
        touched = [group for group in groups if not group.isdisjoint(names)]
        groups = [group for group in groups if group not in touched]
        groups.append(set(names).union(*touched))
    return {
        key: next(i for i, g in enumerate(groups) if names[0] in g) for key, names in ends.items()
    }
