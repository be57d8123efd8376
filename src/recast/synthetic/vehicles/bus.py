"""City buses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.surface import Surface
from recast.synthetic.vehicles import fittings
from recast.synthetic.vehicles.details import Parts, destination, number_plate
from recast.synthetic.vehicles.finishes import (
    CLADDING,
    GLASS,
    SEAM,
    TRIM,
    Area,
    rectangle,
    smooth_max,
    strip,
    xyz,
)
from recast.synthetic.vehicles.front import front_face
from recast.synthetic.vehicles.glazing import face_window
from recast.synthetic.vehicles.loft import Body
from recast.synthetic.vehicles.panels import seam, underside, wheel_wells
from recast.synthetic.vehicles.parameters import VehicleParameters
from recast.synthetic.vehicles.profile import Profile
from recast.synthetic.vehicles.rear import tail_lamp
from recast.synthetic.vehicles.solid import Finish, Solid
from recast.synthetic.vehicles.wheels import steel_wheels

Array = NDArray[np.float64]


def bus(p: VehicleParameters, paint: Finish) -> Parts:
    """Closed parts of a city bus, doors on the right; heights above the ground."""
    end, half = p.length / 2, p.width / 2
    front, rear = p.axles
    roof = p.height - 0.16
    radius = p.wheel_radius
    top = Profile.rounded(
        [(0.0, roof - 0.14, 0.0), (0.5, roof - 0.02, 0.5), (2.0, roof, 0.5),
         (p.length - 0.6, roof, 0.4), (p.length, roof - 0.1 - p.roof_drop, 0.0)]
    )  # fmt: skip
    body = Body(
        length=p.length, width=p.width, top=top, bottom=p.ground_clearance, belt=p.belt_height,
        rise=0.08, tumblehome=p.tumblehome, crown=0.07, wrap=0.0, bow_front=p.bow, bow_rear=0.05,
        lean_front=float(np.tan(p.windscreen_rake)), lean_rear=0.02, corner=p.corner, taper=0.01,
        edge=0.16, arches=((front, radius, radius + 0.06), (rear, radius, radius + 0.06)),
        bumper=0.7, cells=(28, 4, 7),
    )  # fmt: skip
    solid = body.half(paint)
    underside(solid, p)
    high = roof - 0.42
    _side_band(solid, p, high)
    face_window(solid, 1.0, end - 0.5, half - 0.1, p.cowl_height - 0.05, high - 0.02)
    sign = _dress_end(solid, p, end, high, roof)
    set_in = [("destination", sign), *front_face(solid, p, end, p.nose_height)]
    face_window(solid, -1.0, -end + 0.4, half - 0.3, p.belt_height + 0.35, high)
    tail_lamp(solid, p, -end, 1.0 + p.tail_height)
    tail_lamp(solid, replace(p, tail_height=0.14, tail_width=0.2), -end, roof - 0.2)
    _engine_grille(solid, p, -end)
    set_in.append(("plate-rear", number_plate(solid, p.ground_clearance + 0.28, -1.0)))
    wheel_wells(solid, body, p)
    whole = solid.mirrored()
    _bus_doors(whole, p)
    parts: Parts = [("body", whole.surface()), *set_in]
    size = (0.26 * p.length, 0.7 * p.width, 0.3)
    pod = fittings.pebble((-0.1 * p.length, 0, p.height - 0.15), size, paint, 5.0, (8, 16))
    parts.append(("air-conditioning", pod.surface()))
    for side in (1.0, -1.0):
        name = "left" if side > 0 else "right"
        for piece in _bus_mirror(end, half, high):
            surface = piece.surface()
            part = surface if side > 0 else fittings.mirrored(surface)
            parts.append((f"mirror-{name}", part))
    return parts + steel_wheels(p, [front], [rear])


def _side_band(solid: Solid, p: VehicleParameters, high: float) -> None:
    """The dark band of side windows, divided by thin posts."""
    end = p.length / 2

    def band(s: Solid) -> Array:
        x, _, z = xyz(s)
        fields = [p.belt_height - z, z - high, x - end + 0.5, -end + 0.55 - x]
        return np.maximum(smooth_max(fields, 0.1), 0.8 - s.coords[:, 1])

    solid.paint(lambda s: band(s) - 0.03, TRIM)
    solid.paint(band, GLASS)
    panes = p.side_windows + 1
    for k in range(1, panes):
        x = end - 0.5 - k * (p.length - 1.05) / panes

        def post(s: Solid, x: float = x) -> Area:
            return strip(s.points[:, 0] - x, 0.045), [band(s)]

        solid.paint(post, TRIM, over=("glass",))

    def flap_line(s: Solid) -> Area:
        return strip(s.points[:, 2] - high + 0.32, 0.014), [band(s) + 0.05]

    solid.paint(flap_line, TRIM, over=("glass",))
    seam(solid, 2, p.ground_clearance + 0.5, (-end + 0.3, end - 0.3), half=0.006)


def _dress_end(solid: Solid, p: VehicleParameters, end: float, high: float, roof: float) -> Surface:
    """The dark brow over the windscreen; returns the lit destination in it."""

    def brow(s: Solid) -> Array:
        x, y, z = xyz(s)
        fields = [high - 0.04 - z, z - roof + 0.1, y - p.width / 2 + 0.14]
        return np.maximum(smooth_max(fields, 0.05), end - 0.5 - x)

    solid.paint(brow, GLASS)
    return destination(solid, (high + roof - 0.1) / 2)


def _engine_grille(solid: Solid, p: VehicleParameters, end: float) -> None:
    low = p.ground_clearance + 0.5

    def area(s: Solid) -> Array:
        x, y, z = xyz(s)
        fields = [y - 0.3 * p.width, low - z, z - p.belt_height - 0.1]
        return np.maximum(smooth_max(fields, 0.05), x - end - 0.3)

    solid.paint(area, CLADDING)
    for k in range(3):

        def slat(s: Solid, k: int = k) -> Area:
            return strip(s.points[:, 2] - low - 0.1 - 0.14 * k, 0.03), [area(s) + 0.04]

        solid.paint(slat, SEAM, over=("plastic",))


def _bus_doors(solid: Solid, p: VehicleParameters) -> None:
    """Two glazed doors on the right side: ahead of the front wheel and between the axles."""
    front, _ = p.axles
    low, high = p.ground_clearance + 0.07, p.height - 0.75
    first = (front + p.wheel_radius + 0.12, p.length / 2 - 0.38)
    second = (front - p.wheel_radius - 2.9, front - p.wheel_radius - 1.6)
    for start, stop in (first, second):
        centre, size = ((start + stop) / 2, (low + high) / 2), (stop - start, high - low)

        def frame(s: Solid, centre=centre, size=size) -> Area:  # type: ignore[no-untyped-def]
            x, _, z = xyz(s)
            return rectangle(x, z, centre, size), [s.coords[:, 1] + 0.8]

        solid.paint(frame, TRIM)
        for side in (-0.25, 0.25):

            def leaf(s: Solid, centre=centre, size=size, side=side) -> Area:  # type: ignore[no-untyped-def]
                x, _, z = xyz(s)
                middle = (centre[0] + side * size[0], centre[1])
                return (
                    rectangle(x, z, middle, (0.5 * size[0] - 0.09, size[1] - 0.16)),
                    [s.coords[:, 1] + 0.8],
                )

            solid.paint(leaf, GLASS)


def _bus_mirror(end: float, half: float, high: float) -> list[Solid]:
    arm = fittings.pebble(
        (end + 0.02, half - 0.05, high + 0.05), (0.5, 0.06, 0.06), TRIM, 4.0, (4, 8)
    )
    shell = fittings.pebble(
        (end + 0.2, half + 0.02, high - 0.22), (0.12, 0.2, 0.5), TRIM, 3.0, (8, 10)
    )
    return [arm, shell]
