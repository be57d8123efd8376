"""What a vehicle shows in front: headlamps, grilles, badge, plate and bumper."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.vehicles.finishes import (
    BEZEL,
    CHROME,
    DAYLIGHT,
    INDICATOR,
    LAMP,
    PLATE,
    PROJECTOR,
    SEAM,
    TRIM,
    Area,
    polygon,
    rectangle,
    smooth_max,
    strip,
    xyz,
)
from recast.synthetic.vehicles.parameters import VehicleParameters
from recast.synthetic.vehicles.solid import Solid

Array = NDArray[np.float64]


def front_face(solid: Solid, p: VehicleParameters, end: float, edge: float) -> None:
    """Paint the front of half a body.

    Args:
        solid: half of the body.
        p: the vehicle.
        end: x of the foremost point.
        edge: height of the face's upper edge: the bonnet's leading edge.
    """
    near = end - 0.55
    top = edge - 0.07
    _headlamp(solid, p, end, top)
    grille_low = top - p.grille_height
    intake = p.ground_clearance + 0.07

    def grille(s: Solid) -> Array:
        x, y, z = xyz(s)
        half = p.grille_width / 2 * (0.82 + 0.18 * (z - grille_low) / p.grille_height)
        fields = [y - half, z - top, grille_low - z]
        return np.maximum(smooth_max(fields, 0.04), near - x)

    def lower(s: Solid) -> Array:
        x, y, z = xyz(s)
        fields = [y - 0.36 * p.width - 0.3 * (z - intake), intake - z, z - intake - p.intake_height]
        return np.maximum(smooth_max(fields, 0.03), near - x)

    if p.chrome:
        solid.paint(lambda s: grille(s) - 0.02, CHROME, over=("paint",))
    solid.paint(grille, TRIM, over=("paint", "chrome"))
    for k in range(p.grille_bars):
        height = grille_low + p.grille_height * (k + 1) / (p.grille_bars + 1)

        def bar(s: Solid, height: float = height) -> Area:
            return strip(s.points[:, 2] - height, 0.009), [grille(s) + 0.01]

        solid.paint(bar, CHROME, over=("plastic",))
    solid.paint(lower, TRIM, over=("paint",))

    def badge(s: Solid) -> Area:
        x, y, z = xyz(s)
        centre = (0.0, top - min(0.5 * p.grille_height, 0.09))
        return polygon(y, z, centre, 0.05), [near - x]

    solid.paint(badge, CHROME)
    _fog_lamp(solid, p, end, intake)
    number_plate(solid, 1.0, end, intake + p.intake_height + 0.06)


def _headlamp(solid: Solid, p: VehicleParameters, end: float, top: float) -> None:
    outer = p.width / 2
    inner = outer - p.lamp_width
    low = top - p.lamp_height

    def lamp(s: Solid) -> Array:
        x, y, z = xyz(s)
        # Along the skin from the inner end outwards, round the corner and back.
        along = (y - inner) + 0.8 * (end - x)
        rise = p.lamp_slant * (along - 0.3)
        fields = [
            inner - y + 0.4 * (z - low),
            end - 0.5 - 0.12 * p.lamp_slant - x,
            low + rise - z,
            z - top - 0.7 * rise - 0.01,
        ]
        return smooth_max(fields, 0.05)

    solid.paint(lamp, BEZEL)
    solid.paint(lambda s: lamp(s) + 0.014, LAMP)
    for share in (0.3, 0.62):

        def projector(s: Solid, share: float = share) -> Area:
            x, y, z = xyz(s)
            centre_y = inner + share * min(p.lamp_width, 0.45)
            height = (low + top) / 2 + p.lamp_slant * (share * p.lamp_width - 0.2)
            radius = min(0.36 * p.lamp_height, 0.055)
            return polygon(y, z, (centre_y, height), radius), [end - 0.4 - x, lamp(s) + 0.01]

        solid.paint(projector, BEZEL if share > 0.5 else PROJECTOR, over=("headlamp",))

    def daylight(s: Solid) -> Area:
        x, y, z = xyz(s)
        rise = p.lamp_slant * ((y - inner) + 0.8 * (end - x) - 0.3)
        return strip(z - low - rise - 0.028, 0.012), [lamp(s) + 0.012]

    solid.paint(daylight, DAYLIGHT, over=("headlamp",))

    def indicator(s: Solid) -> Area:
        return [s.points[:, 0] - end + 0.34], [lamp(s) + 0.012]

    solid.paint(indicator, INDICATOR, over=("headlamp",))


def _fog_lamp(solid: Solid, p: VehicleParameters, end: float, low: float) -> None:
    centre = (0.385 * p.width, low + 0.09)

    def pocket(s: Solid) -> Area:
        x, y, z = xyz(s)
        return rectangle(y, z, centre, (0.17, 0.11)), [end - 0.6 - x]

    def lamp(s: Solid) -> Area:
        x, y, z = xyz(s)
        return polygon(y, z, centre, 0.036), [end - 0.6 - x]

    solid.paint(pocket, TRIM, over=("paint", "plastic"))
    solid.paint(lamp, LAMP)


def number_plate(solid: Solid, sign: float, end: float, low: float, wide: float = 0.52) -> None:
    """A plate in the middle of the front (sign 1) or the rear (-1) whose lower edge is at `low`."""
    from recast.synthetic.vehicles.finishes import INK, REAR_PLATE

    centre = (0.0, low + 0.055)

    def area(s: Solid, grow: float = 0.0) -> Area:
        x, y, z = xyz(s)
        size = (wide + grow, 0.11 + grow)
        return rectangle(y, z, centre, size)[:1] + rectangle(y, z, centre, size)[2:], [sign * (end - sign * 0.4 - x)]

    solid.paint(lambda s: area(s, 0.024), SEAM)
    solid.paint(area, PLATE if sign > 0 else REAR_PLATE)
    for k in range(4):

        def letter(s: Solid, k: int = k) -> Area:
            x, y, z = xyz(s)
            middle = 0.028 + 0.058 * k
            return rectangle(y, z, (middle, centre[1]), (0.03, 0.062)), area(s)[1]

        solid.paint(letter, INK, over=("plate",))
