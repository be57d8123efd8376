"""Windscreen, side windows, rear window and the pillars between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.vehicles.finishes import (
    CHROME,
    DARK_GLASS,
    GLASS,
    TRIM,
    Area,
    smooth_max,
    strip,
    xyz,
)
from recast.synthetic.vehicles.loft import Body
from recast.synthetic.vehicles.solid import Finish, Solid

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SideGlass:
    """The outline of the side windows in the side view.

    Attributes:
        rear: x at the belt line where the glass ends.
        rear_lean: metres that the rear end moves forward per metre of height.
        pillar: width of the windscreen pillar and the roof rail above the glass.
        front: x at the belt line where it begins; None follows the windscreen.
        sill: height of the lower edge over the belt line.
        tall: greatest height of the glass over the belt line.
    """

    rear: float
    rear_lean: float
    pillar: float = 0.1
    front: float | None = None
    sill: float = 0.015
    tall: float = 2.0

    def field(self, body: Body, solid: Solid) -> Array:
        """Negative inside."""
        x, _, z = xyz(solid)
        station, across, _ = solid.coords.T
        slope = body.top.slope(body.length / 2 - station)
        over = (z - body.outline(station)) / np.sqrt(1 + slope**2) + self.pillar
        belt = body.belt_at(x)
        fields = [belt + self.sill - z, over, z - belt - self.tall]
        fields.append((self.rear + self.rear_lean * (z - belt)) - x)
        if self.front is not None:
            fields.append(x - self.front)
        return np.maximum(smooth_max(fields, 0.06), 0.8 - across)


def side_windows(
    solid: Solid, body: Body, glass: SideGlass, pillars: Sequence[float], chrome: bool
) -> None:
    """Glass with a trim around it, divided at the pillars' x."""
    solid.paint(lambda s: glass.field(body, s) - 0.018, CHROME if chrome else TRIM)
    solid.paint(lambda s: glass.field(body, s), GLASS)
    for k, pillar in enumerate(pillars):
        half = 0.045 if k == 0 else 0.032

        def post(s: Solid, x: float = pillar, half: float = half) -> Area:
            lean = 0.08 * (s.points[:, 2] - body.belt_at(s.points[:, 0]))
            return strip(s.points[:, 0] - x + lean, half), [glass.field(body, s)]

        solid.paint(post, TRIM, over=("glass",))


def screen(
    solid: Solid,
    body: Body,
    low_x: float,
    high_x: float,
    inset: float,
    paint: Finish | None = None,
    low_z: float = 0.0,
) -> None:
    """A window in the upper skin between two stations, such as the windscreen.

    Args:
        solid: half of the body.
        body: its shape.
        low_x, high_x: where the glass begins and ends, x in the middle plane.
        inset: metres from the glass to the upper edge of the side.
        paint: finish of the frame; None gives a black band of ceramic ink.
        low_z: the glass stays above.
    """

    def field(s: Solid) -> Array:
        station, across, up = s.coords.T
        slope = np.sqrt(1 + body.top.slope(body.length / 2 - station) ** 2)
        half = body.half_width(s.points[:, 0], s.points[:, 2])
        sides = (across - 1) * half + inset
        fields = [(low_x - station) * slope, (station - high_x) * slope, sides]
        fields.append(low_z - s.points[:, 2])
        return np.maximum(smooth_max(fields, 0.07), 0.8 - up)

    solid.paint(field, paint or TRIM)
    solid.paint(lambda s: field(s) + 0.035, GLASS)


def face_window(
    solid: Solid, sign: float, x_limit: float, half: float, low: float, high: float
) -> None:
    """Glass in an upright end of the body: front (sign 1) or rear (-1)."""

    def field(s: Solid) -> Array:
        x, y, z = xyz(s)
        fields = [y - half, low - z, z - high]
        return np.maximum(smooth_max(fields, 0.08), sign * (x_limit - x))

    solid.paint(lambda s: field(s) - 0.03, TRIM)
    solid.paint(field, DARK_GLASS if sign < 0 else GLASS)
