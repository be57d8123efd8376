"""Layouts that several kinds share: roads that meet at a junction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from recast.synthetic.streets.network import Arm, Network
from recast.synthetic.streets.reference_line import ReferenceLine
from recast.synthetic.streets.road import Road, Section

_SIDE_SPEED = 8.3


@dataclass(frozen=True)
class Tee:
    """A road, and one that joins it from the side.

    Attributes:
        network: roads and lanes.
        main, ahead: the through road before and after the junction, on one line.
        side: leads away from the junction.
    """

    network: Network
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
        line: of the through road.
        section, minor: of the through road and of the side road.
        crossing: arc length of the side road's middle.
        way: +1 joins from the left, -1 from the right.
        speed: limit on the through road, m/s.
        fillet: radius of the kerbs at the corners.
        zebra: leave room for a crossing before the junction.
        barred: as in `Network.junction`.
        side_length: metres of the side road.
    """
    half = minor.kerb(1) + fillet + (5.0 if zebra else 0.5)
    main = Road("main", line, section, 0.0, crossing - half, speed, (0.0, crossing))
    total = line.length
    ahead = Road("ahead", line, section, crossing + half, total, speed, (crossing, total))
    here = line.pose(crossing)
    side_line = ReferenceLine.straight(
        here._replace(heading=here.heading + way * np.pi / 2), side_length
    )
    kerb = abs(section.kerb(way))
    begin = kerb - 3.0 if section.median > 0.5 else 0.0
    start = kerb + fillet + 0.5
    side = Road("side", side_line, minor, start, side_length, _SIDE_SPEED, (begin, side_length))
    network = Network([main, ahead, side])
    arms = [Arm(main, True), Arm(ahead, False), Arm(side, False)]
    network.junction("crossing", arms, fillet + 3.0, barred)
    return Tee(network, main, ahead, side)
