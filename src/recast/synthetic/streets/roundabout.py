"""Roundabouts: a ring driven counter-clockwise, and roads that meet it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from recast.synthetic.streets.network import Arm, Network
from recast.synthetic.streets.reference_line import Pose, ReferenceLine
from recast.synthetic.streets.road import Road, Section

_LANE = 3.7
_RING_HALF = 3.3
"""Half the width of the ring's asphalt."""
_GAP = 7.0
"""Metres from the ring's asphalt to where the roads' lanes end."""
_JOIN = 0.56
"""Radians between an arm's axis and where its lanes leave and join the ring."""
_SPREAD = 2.3
"""Metres by which the lanes of a road move apart on both sides of the splitter island."""


@dataclass(frozen=True)
class Roundabout:
    """A roundabout and its roads.

    Attributes:
        network: roads and lanes.
        arms: its roads; the one named "main" ends here, all others begin here.
        centre: x, y.
        radius: of the ring's middle.
        spokes: name, angle seen from the centre, and length of each road.
        splitters: islands between the directions of each road.
    """

    network: Network
    arms: tuple[Road, ...]
    centre: tuple[float, float]
    radius: float
    spokes: tuple[tuple[str, float, float], ...]
    splitters: tuple[shapely.Polygon, ...]

    @property
    def island_radius(self) -> float:
        """Metres from the centre to the kerb of the island in the middle."""
        return self.radius - _RING_HALF

    @property
    def disc(self) -> shapely.Polygon:
        """All within the outer edge of the ring."""
        return shapely.Point(self.centre).buffer(self.radius + _RING_HALF, quad_segs=24)

    @property
    def centre_disc(self) -> shapely.Polygon:
        """The island in the middle."""
        return shapely.Point(self.centre).buffer(self.island_radius, quad_segs=24)


def make_roundabout(
    centre: Pose, radius: float, arms: tuple[tuple[str, float, float], ...], speed: float
) -> Roundabout:
    """A roundabout with one lane.

    Args:
        centre: of the ring; its heading is not used.
        radius: of the ring's middle, metres.
        arms: name, angle seen from the centre in radians, and length in metres of each road, in
            counter-clockwise order. "main" leads to the ring, the others away from it.
        speed: limit on the roads, m/s.
    """
    section = Section(1, 1, lane_width=3.4, edge=0.35)
    inner = radius + _RING_HALF + _GAP
    roads = []
    for name, angle, length in arms:
        out = np.array([np.cos(angle), np.sin(angle)])
        near = np.array(centre[:2]) + inner * out
        if name == "main":
            far = near + length * out
            line = ReferenceLine.straight(Pose(far[0], far[1], angle + np.pi), length)
            spread = ((0.0, 0.0), (length - 27.0, 0.0), (length - 4.0, _SPREAD),
                      (length + _GAP, _SPREAD))  # fmt: skip
            paved = (0.0, length + _GAP)
        else:
            line = ReferenceLine.straight(Pose(near[0], near[1], angle), length)
            spread = ((-_GAP, _SPREAD), (4.0, _SPREAD), (27.0, 0.0), (length, 0.0))
            paved = (-_GAP, length)
        roads.append(Road(name, line, section, 0.0, length, speed, paved, spread))
    network = Network(roads)
    _link(network, roads, centre, radius, [angle for _, angle, _ in arms])
    return Roundabout(
        network,
        tuple(roads),
        (centre.x, centre.y),
        radius,
        arms,
        tuple(island for road in roads for island in _splitters(road)),
    )


def _link(
    network: Network, roads: list[Road], centre: Pose, radius: float, angles: list[float]
) -> None:
    """Ring lanes from each exit to the entry beside it and on to the next exit, and joins."""
    middle = np.array(centre[:2])
    count = len(roads)
    for k, (road, angle) in enumerate(zip(roads, angles, strict=True)):
        gap = float(np.mod(angles[(k + 1) % count] - angle, 2 * np.pi))
        pieces = (("across", -_JOIN, 2 * _JOIN), ("round", _JOIN, gap - 2 * _JOIN))
        for piece, start, turn in pieces:
            line = ReferenceLine.circle(middle, radius, angle + start, turn)
            network.add(f"ring-{road.name}-{piece}", line, (_LANE, _LANE))
    for k, road in enumerate(roads):
        arm = Arm(road, road.name == "main")
        following = roads[(k + 1) % count].name
        before = roads[k - 1].name
        across, after = f"ring-{road.name}-across", f"ring-{road.name}-round"
        network.follow(across, after)
        network.follow(after, f"ring-{following}-across")
        network.connect(f"enter-{road.name}", arm.incoming()[0], after)
        network.connect(f"leave-{road.name}", f"ring-{before}-round", arm.outgoing()[0])


def _splitters(road: Road) -> list[shapely.Polygon]:
    """Raised islands where a road's directions have moved apart, before and after a crossing."""
    s = road.stations(*((road.end - 24.0, road.end + 1.0) if road.name == "main"
                        else (road.start - 1.0, road.start + 24.0)), 1.0)  # fmt: skip
    half = np.maximum(road.apart(s) - 0.35, 0.0)
    wide = half > 0.25
    s, half = s[wide], half[wide]
    rim = np.concatenate([road.line.offset(s, -half), road.line.offset(s, half)[::-1]])
    whole = shapely.Polygon(rim).buffer(-0.2).buffer(0.2)
    at = road.end - 8.0 if road.name == "main" else road.start + 8.0
    crossing = shapely.LineString(road.line.offset(np.full(2, at), np.array([-6.0, 6.0])))
    return list(shapely.get_parts(whole.difference(crossing.buffer(2.0, cap_style="flat"))))
