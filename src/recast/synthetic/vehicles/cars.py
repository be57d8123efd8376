"""Hatchbacks, sedans, estates, SUVs, pickups and vans: one body with a bonnet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.vehicles import fittings
from recast.synthetic.vehicles.car_openings import open_bed, rear_window, side_layout
from recast.synthetic.vehicles.car_shape import car_body, screen_run
from recast.synthetic.vehicles.details import Parts
from recast.synthetic.vehicles.finishes import (
    CHROME,
    SEAM,
    TRIM,
    Area,
    strip,
    xyz,
)
from recast.synthetic.vehicles.front import front_face
from recast.synthetic.vehicles.glazing import screen, side_windows
from recast.synthetic.vehicles.loft import Body
from recast.synthetic.vehicles.panels import doors, seam, underside, wheel_wells
from recast.synthetic.vehicles.parameters import VehicleParameters
from recast.synthetic.vehicles.rear import rear_face
from recast.synthetic.vehicles.solid import Finish, Solid
from recast.synthetic.vehicles.wheels import wheel

Array = NDArray[np.float64]


def car(p: VehicleParameters, paint: Finish) -> Parts:
    """Closed parts of a car, by name; heights above the ground."""
    body = car_body(p)
    solid = body.half(paint)
    end = p.length / 2
    cowl, brow = end - p.bonnet_length, end - p.bonnet_length - screen_run(p)
    deck = -end + p.deck_length
    gutter = deck + (p.height - p.roof_drop - p.deck_height) * np.tan(p.rear_rake)
    underside(solid, p)
    _bonnet_lines(solid, p, end, cowl)
    screen(solid, body, brow + 0.02, cowl - 0.07, 0.075)
    glass, pillars, edges = side_layout(p, body, gutter)
    side_windows(solid, body, glass, pillars, p.chrome)
    doors(solid, body, p, edges)
    rear_window(solid, body, p, deck, gutter)
    set_in = front_face(solid, p, end, p.nose_height)
    plate = {"sedan": 0.46, "pickup": 0.5, "van": 0.5, "suv": 0.55}.get(p.kind, 0.48)
    low = p.ground_clearance + plate * (p.deck_height - p.ground_clearance)
    top = {"van": 1.0, "sedan": 0.95, "pickup": 0.97}.get(p.kind, 0.97) * p.deck_height
    set_in += rear_face(solid, p, -end, top, low, exhaust=p.chrome and p.kind != "van")
    wheel_wells(solid, body, p)
    if p.kind == "pickup":
        open_bed(solid, p, deck, -end)
    parts: Parts = [("body", solid.mirrored().surface()), *set_in]
    side = _fittings(p, body, paint, cowl, edges, brow, gutter)
    return parts + fittings.both(side)


def _bonnet_lines(solid: Solid, p: VehicleParameters, end: float, cowl: float) -> None:
    edge = 0.4 * p.width
    seam_x = end - 0.16

    def sides(s: Solid) -> Area:
        x, y, _ = xyz(s)
        off = y - edge + 0.04 * (x - cowl)
        return strip(off, 0.004), [x - seam_x, cowl - 0.03 - x, 0.8 - s.coords[:, 2]]

    if p.bonnet_length > 0.6:
        solid.paint(sides, SEAM, over=("paint",))

    # The cowl between bonnet and windscreen is black.
    def grille(s: Solid) -> Area:
        station, across, up = s.coords.T
        return [cowl - 0.08 - station, station - cowl + 0.005, across - 0.88], [0.8 - up]

    solid.paint(grille, TRIM)
    seam(solid, 0, end - 0.42, (p.ground_clearance + 0.1, p.nose_height - p.lamp_height - 0.1))


def _fittings(
    p: VehicleParameters, body: Body, paint: Finish, cowl: float, edges: list[float],
    brow: float, gutter: float,
) -> Parts:  # fmt: skip
    """Parts of the left side."""

    def skin(x: float, z: float) -> float:
        return float(body.half_width(np.array(x), np.array(z)))

    parts: Parts = []
    front, rear = p.axles
    turned = wheel(p.wheel_radius, p.tyre_width, p.rim_share, p.spokes, dished=False)
    for name, x in (("wheel-front", front), ("wheel-rear", rear)):
        pose = np.eye(4)
        pose[:3, 3] = x, p.width / 2 - p.tyre_width / 2 - 0.035, p.wheel_radius
        parts.append((name, turned.transformed(pose)))
    mx = min(cowl - 0.38, edges[0] - 0.05) if p.kind != "van" else edges[0] - 0.1
    mz = float(body.belt_at(np.array(mx))) + 0.05
    pieces = fittings.mirror(mx, skin(mx, mz) - 0.01, mz, paint, tall=p.kind == "van")
    parts += [("mirror", pieces[0].surface()), ("mirror-foot", pieces[1].surface())]
    finish = CHROME if p.chrome else paint
    for k, x in enumerate(edges[1:]):
        hx = x + 0.16
        hz = float(body.belt_at(np.array(hx))) - 0.1
        parts.append((f"handle-{k}", fittings.handle(hx, skin(hx, hz), hz, finish).surface()))
    if p.roof_rails:
        start, stop = brow - 0.25, gutter + 0.25
        y = 0.5 * p.width - np.tan(p.tumblehome) * (p.height - p.belt_height) - 0.14
        z = [float(body.outline(np.array(x))) - 0.015 for x in (start, stop)]
        pieces = fittings.rail((start, y, z[0]), (stop, y, z[1]))
        parts += [(f"rail-{k}", piece.surface()) for k, piece in enumerate(pieces)]
    return parts
