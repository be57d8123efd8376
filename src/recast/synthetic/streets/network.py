"""The lane graph: roads, the connections through junctions, and roads that meet in a tee."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from recast.geometry import se2
from recast.logs import Lane
from recast.synthetic.streets.road import Road, Section, make_lane
from recast.synthetic.streets.shapes import Pose, ReferenceLine

_STRAIGHT = np.deg2rad(35)
_TURN_SPEED = 8.0
_SIDE_SPEED = 8.3


@dataclass(frozen=True)
class JunctionArm:
    """A road's end at a junction.

    Attributes:
        at_end: its forward lanes enter the junction; else its backward lanes do.
    """

    road: Road
    at_end: bool

    def incoming(self) -> list[str]:
        """Ids of lanes that enter the junction, from the middle outwards."""
        return self._lanes(1 if self.at_end else -1)

    def outgoing(self) -> list[str]:
        """Ids of lanes that leave the junction, from the middle outwards."""
        return self._lanes(-1 if self.at_end else 1)

    def _lanes(self, direction: int) -> list[str]:
        section = self.road.section
        count = section.forward if direction > 0 else section.backward
        block = len(self.road.blocks()) - 2 if self.at_end else 0
        return [self.road.lane_id(block, direction * k) for k in range(1, count + 1)]


class StreetNetwork:
    """Collects roads and lanes.

    Attributes:
        roads: roads by name.
        lanes: lanes by id.
    """

    def __init__(self, roads: Sequence[Road]) -> None:
        self.roads = {road.name: road for road in roads}
        self.lanes: dict[str, Lane] = {
            lane.lane_id: lane for road in roads for lane in road.lanes()
        }

    def add(self, lane_id: str, line: ReferenceLine, widths: tuple[float, float]) -> str:
        """Add a lane of a junction along `line`; its width changes evenly between `widths`."""
        s = np.linspace(0.0, line.length, max(int(np.ceil(line.length / 1.0)), 2) + 1)
        half = np.linspace(widths[0], widths[1], len(s)) / 2
        self.lanes[lane_id] = make_lane(
            lane_id,
            line.offset(s, np.zeros_like(s)),
            line.offset(s, half),
            line.offset(s, -half),
            _TURN_SPEED,
            is_intersection=True,
        )
        return lane_id

    def follow(self, lane_id: str, *successors: str) -> None:
        """Let `successors` be driven on into from a lane."""
        lane = self.lanes[lane_id]
        self.lanes[lane_id] = replace(lane, successors=(*lane.successors, *successors))

    def connect(self, lane_id: str, source: str, target: str, reach: float = np.inf) -> str:
        """Add a lane from the end of one to the start of another."""
        first, last = self.lanes[source], self.lanes[target]
        line = ReferenceLine.between(end_pose(first), start_pose(last), reach)
        self.add(lane_id, line, (_width(first, -1), _width(last, 0)))
        # The ends are those of the lanes joined, to the last digit.
        joined = self.lanes[lane_id]
        lines = []
        for name in ("centreline", "left_boundary", "right_boundary"):
            points = getattr(joined, name).copy()
            points[0], points[-1] = getattr(first, name)[-1], getattr(last, name)[0]
            lines.append(points[:, :2])
        middle, left, right = lines
        self.lanes[lane_id] = make_lane(
            lane_id, middle, left, right, _TURN_SPEED, (target,), is_intersection=True
        )
        self.follow(source, lane_id)
        return lane_id

    def junction(
        self,
        name: str,
        arms: Sequence[JunctionArm],
        right_reach: float,
        barred: Sequence[tuple[str, str]] = (),
    ) -> None:
        """Connect all arms: straight on lane by lane, left from the inner, right from the outer.

        Args:
            name: first part of the ids of its lanes.
            arms: the roads' ends.
            right_reach: metres before the corner at which right turns begin.
            barred: names of roads (from, to) between which one cannot turn.
        """
        for arm in arms:
            for other in arms:
                if (arm.road.name, other.road.name) in barred:
                    continue
                if other is arm or not arm.incoming() or not other.outgoing():
                    continue
                self._movement(name, arm, other, right_reach)

    def _movement(
        self, name: str, arm: JunctionArm, other: JunctionArm, right_reach: float
    ) -> None:
        sources, targets = arm.incoming(), other.outgoing()
        leaving, entering = self.lanes[sources[0]], self.lanes[targets[0]]
        turn = float(se2.wrap_angle(start_pose(entering).heading - end_pose(leaving).heading))
        stem = f"{name}-{arm.road.name}-{other.road.name}"
        if abs(turn) < _STRAIGHT:
            made = [
                self.connect(f"{stem}-{k + 1}", source, target)
                for k, (source, target) in enumerate(zip(sources, targets, strict=False))
            ]
            for k, lane_id in enumerate(made):
                self.lanes[lane_id] = replace(
                    self.lanes[lane_id],
                    speed_limit=leaving.speed_limit,
                    left_neighbour=made[k - 1] if k > 0 else None,
                    right_neighbour=made[k + 1] if k + 1 < len(made) else None,
                )
        elif turn > 0:
            self.connect(f"{stem}-left", sources[0], targets[0])
        else:
            self.connect(f"{stem}-right", sources[-1], targets[-1], right_reach)

    def route(self, start: str, goal: str) -> tuple[str, ...]:
        """Ids of the lanes from start to goal, the fewest.

        Raises:
            ValueError: the goal cannot be reached.
        """
        chains: deque[tuple[str, ...]] = deque([(start,)])
        met = {start}
        while chains:
            chain = chains.popleft()
            if chain[-1] == goal:
                return chain
            ahead = [name for name in self.lanes[chain[-1]].successors if name not in met]
            met.update(ahead)
            chains.extend((*chain, name) for name in ahead)
        raise ValueError(f"no way from lane {start!r} to {goal!r}")


def start_pose(lane: Lane) -> Pose:
    """Where a lane begins; the heading is square to the line between its boundaries' ends."""
    return _end(lane, 0)


def end_pose(lane: Lane) -> Pose:
    """Where a lane ends; the heading is square to the line between its boundaries' ends."""
    return _end(lane, -1)


def _end(lane: Lane, k: int) -> Pose:
    across = lane.left_boundary[k] - lane.right_boundary[k]
    heading = float(np.arctan2(-across[0], across[1]))
    return Pose(float(lane.centreline[k, 0]), float(lane.centreline[k, 1]), heading)


def _width(lane: Lane, k: int) -> float:
    return float(np.linalg.norm(lane.left_boundary[k] - lane.right_boundary[k]))


@dataclass(frozen=True)
class Tee:
    """A road, and one that joins it from the side.

    Attributes:
        network: roads and lanes.
        main, ahead: the through road before and after the junction, on one line.
        side: road that leads away from the junction.
    """

    network: StreetNetwork
    main: Road
    ahead: Road
    side: Road

    def route(self, index: int) -> tuple[str, ...]:
        """Straight through, on lane `index` (1 is the innermost)."""
        last = len(self.ahead.blocks()) - 2
        return self.network.route(self.main.lane_id(0, index), self.ahead.lane_id(last, index))


def tee(
    line: ReferenceLine,
    section: Section,
    minor: Section,
    crossing: float,
    way: int,
    speed: float,
    fillet: float,
    zebra: bool = True,
    barred: Sequence[tuple[str, str]] = (),
    side_length: float = 90.0,
) -> Tee:
    """A side road at arc length `crossing` of a through road.

    Args:
        line: reference line of the through road.
        section: section of the through road.
        minor: section of the side road.
        crossing: arc length of the side road's middle.
        way: +1 joins from the left, -1 from the right.
        speed: limit on the through road, m/s.
        fillet: radius of the kerbs at the corners.
        zebra: leave room for a crossing before the junction.
        barred: names of roads (from, to) between which one cannot turn, as in
            `StreetNetwork.junction`.
        side_length: metres of the side road.
    """
    half = minor.kerb(1) + fillet + (5.0 if zebra else 0.5)
    main = Road("main", line, section, 0.0, crossing - half, speed, (0.0, crossing))
    total = line.length
    ahead = Road("ahead", line, section, crossing + half, total, speed, (crossing, total))
    here = line.pose(crossing)
    across = here._replace(heading=here.heading + way * np.pi / 2)
    side_line = ReferenceLine.straight(across, side_length)
    kerb = abs(section.kerb(way))
    begin = kerb - 3.0 if section.median > 0.5 else 0.0
    start = kerb + fillet + 0.5
    side = Road("side", side_line, minor, start, side_length, _SIDE_SPEED, (begin, side_length))
    network = StreetNetwork([main, ahead, side])
    arms = [JunctionArm(main, True), JunctionArm(ahead, False), JunctionArm(side, False)]
    network.junction("crossing", arms, fillet + 3.0, barred)
    return Tee(network, main, ahead, side)
