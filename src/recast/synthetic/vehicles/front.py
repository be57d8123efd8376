"""What a vehicle shows in front: headlamps, grilles, badge, plate and bumper."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.vehicles.details import Parts, badge, disc, number_plate
from recast.synthetic.vehicles.finishes import (
    BEZEL,
    CHROME,
    DAYLIGHT,
    INDICATOR,
    LAMP,
    PROJECTOR,
    TRIM,
    Area,
    rectangle,
    smooth_max,
    strip,
    xyz,
)
from recast.synthetic.vehicles.parameters import VehicleParameters
from recast.synthetic.vehicles.solid import Finish, Solid

Array = NDArray[np.float64]


def front_face(solid: Solid, p: VehicleParameters, end: float, edge: float) -> Parts:
    """Paint the front of half a body; returns the parts that are set into it.

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

    _fog_pocket(solid, p, end, intake)
    spots = _spots(p, top)
    parts: Parts = []
    for name, (y, z, radius, finish) in spots.items():
        for side, sign in (("left", 1), ("right", -1)):
            parts.append((f"{name}-{side}", disc(solid, sign * y, z, 1.0, radius, finish)))
    parts.append(("badge", badge(solid, top - min(0.5 * p.grille_height, 0.09), 1.0)))
    parts.append(("plate-front", number_plate(solid, intake + p.intake_height + 0.02, 1.0)))
    return parts


def _spots(p: VehicleParameters, top: float) -> dict[str, tuple[float, float, float, Finish]]:
    """Round lamps: y, z, radius and finish."""
    inner, middle = p.width / 2 - p.lamp_width, top - 0.5 * p.lamp_height
    spots = {}
    for k, share in enumerate((0.27, 0.55)):
        along = share * min(p.lamp_width, 0.46)
        height = middle + 0.85 * p.lamp_slant * (along - 0.22)
        radius = min(0.33 * p.lamp_height, 0.05)
        spots[f"projector-{k}"] = (inner + along, height, radius, PROJECTOR)
    spots["fog-lamp"] = (0.385 * p.width, p.ground_clearance + 0.16, 0.035, LAMP)
    return spots


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

    def daylight(s: Solid) -> Area:
        x, y, z = xyz(s)
        rise = p.lamp_slant * ((y - inner) + 0.8 * (end - x) - 0.3)
        return strip(z - low - rise - 0.028, 0.012), [lamp(s) + 0.012]

    solid.paint(daylight, DAYLIGHT, over=("headlamp",))

    def indicator(s: Solid) -> Area:
        return strip(s.points[:, 0] - end + 0.37, 0.025), [lamp(s) + 0.012]

    solid.paint(indicator, INDICATOR, over=("headlamp",))


def _fog_pocket(solid: Solid, p: VehicleParameters, end: float, low: float) -> None:
    centre = (0.385 * p.width, low + 0.09)

    def pocket(s: Solid) -> Area:
        x, y, z = xyz(s)
        return rectangle(y, z, centre, (0.17, 0.11)), [end - 0.6 - x]

    solid.paint(pocket, TRIM, over=("paint", "plastic"))
