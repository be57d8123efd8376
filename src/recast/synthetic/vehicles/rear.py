"""What a vehicle shows behind: tail lamps, tailgate, plate and bumper."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.vehicles.details import Parts, badge, number_plate, pipe
from recast.synthetic.vehicles.finishes import (
    BEZEL,
    INDICATOR,
    REVERSE,
    SEAM,
    TAIL,
    TRIM,
    Area,
    rectangle,
    smooth_max,
    strip,
    xyz,
)
from recast.synthetic.vehicles.parameters import VehicleParameters
from recast.synthetic.vehicles.solid import Solid

Array = NDArray[np.float64]


def rear_face(
    solid: Solid, p: VehicleParameters, end: float, top: float, plate_low: float, exhaust: bool
) -> Parts:
    """Paint the rear of half a body; returns the parts that are set into it.

    Args:
        solid: half of the body.
        p: the vehicle.
        end: x of the rearmost point.
        top: height of the tail lamps' upper edge.
        plate_low: height of the plate's lower edge.
        exhaust: bright pipes in the bumper.
    """
    sill = p.ground_clearance
    near = end + 0.5

    def apron(s: Solid) -> Array:
        x, y, z = xyz(s)
        fields = [z - sill - 0.15 + 0.25 * np.maximum(y - 0.3 * p.width, 0), y - 0.44 * p.width]
        return np.maximum(smooth_max(fields, 0.04), x - near)

    solid.paint(apron, TRIM, over=("paint",))
    tail_lamp(solid, p, end, top)
    gate = 0.4 * p.width
    foot = min(plate_low - 0.05, top - 0.2)

    def gate_edge(s: Solid) -> Area:
        x, y, z = xyz(s)
        return strip(y - gate, 0.005), [x - near, foot - z, z - top - 0.25]

    def gate_foot(s: Solid) -> Area:
        x, y, z = xyz(s)
        return strip(z - foot, 0.006), [x - near, y - gate]

    solid.paint(gate_edge, SEAM, over=("paint",))
    solid.paint(gate_foot, SEAM, over=("paint",))

    def reflector(s: Solid) -> Area:
        x, y, z = xyz(s)
        return rectangle(y, z, (0.38 * p.width, sill + 0.19), (0.16, 0.04)), [x - near]

    solid.paint(reflector, TAIL, over=("paint", "plastic"))
    parts: Parts = [
        ("badge-rear", badge(solid, top - 0.05, -1.0, 0.04)),
        ("plate-rear", number_plate(solid, plate_low, -1.0)),
    ]
    if exhaust:
        for side, sign in (("left", 1), ("right", -1)):
            parts.append((f"pipe-{side}", pipe(solid, sign * 0.3 * p.width, sill + 0.06)))
    return parts


def tail_lamp(solid: Solid, p: VehicleParameters, end: float, top: float) -> None:
    """A lamp at the corner, upright where it is higher than wide, with indicator and reverse."""
    inner = p.width / 2 - p.tail_width
    low = top - p.tail_height
    reach = 0.1 if p.tail_height > 1.5 * p.tail_width else 0.3

    upright = p.tail_height > p.tail_width

    def lamp(s: Solid) -> Array:
        x, y, z = xyz(s)
        back = x - end - 0.25
        fields = [
            inner - y + (0.03 if upright else 0.25) * (z - low),
            x - end - reach - 0.06,
            low - z + 0.08 * back,
            z - top - 0.1 * back,
        ]
        return smooth_max(fields, 0.04)

    solid.paint(lamp, BEZEL)
    solid.paint(lambda s: lamp(s) + 0.011, TAIL)

    def band(s: Solid, start: float, stop: float) -> Area:
        _, y, z = xyz(s)
        share = (z - low) / p.tail_height if upright else (y - inner) / p.tail_width
        size = p.tail_height if upright else p.tail_width
        return [(start - share) * size, (share - stop) * size], [lamp(s) + 0.011]

    solid.paint(lambda s: band(s, 0.05, 0.2), REVERSE, over=("taillamp",))
    solid.paint(lambda s: band(s, 0.22, 0.34), INDICATOR, over=("taillamp",))
