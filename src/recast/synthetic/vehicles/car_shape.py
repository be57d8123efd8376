"""The shape of a car's body, from its parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.vehicles.loft import Body
from recast.synthetic.vehicles.parameters import VehicleParameters
from recast.synthetic.vehicles.profile import Profile

Array = NDArray[np.float64]


def car_body(p: VehicleParameters) -> Body:
    """The shape of the body."""
    front, rear = p.axles
    radius = p.wheel_radius
    gap = 1.12 if p.kind in ("suv", "pickup") else 1.09
    boxy = p.kind == "van"
    return Body(
        length=p.length, width=p.width, top=_outline(p), bottom=p.ground_clearance,
        belt=p.belt_height + p.wedge * front, wedge=p.wedge, tumblehome=p.tumblehome,
        shoulder=p.shoulder, crown=0.06 if boxy else 0.05, wrap=0.16 if boxy else 0.14,
        wrap_rear=0.0 if boxy else min(0.14, 0.25 * p.rear_rake),
        bow_front=p.bow, bow_rear=0.4 * p.bow, lean_front=0.22 if not boxy else 0.12,
        lean_rear=float(np.tan(p.rear_rake)) if boxy else 0.1,
        corner=p.corner, taper=0.05, edge=0.11,
        arches=((front, radius, gap * radius + 0.01), (rear, radius, gap * radius + 0.01)),
        flare=p.flare, crease=p.crease, bumper=0.5 * (p.ground_clearance + p.nose_height) - 0.05,
        cells=(34, 4, 9),
    )  # fmt: skip


def screen_run(p: VehicleParameters) -> float:
    """Length of the windscreen seen from above."""
    return (p.height - p.roof_arch - p.cowl_height) * float(np.tan(p.windscreen_rake))


def _outline(p: VehicleParameters) -> Profile:
    roof = p.height - p.roof_arch
    screen_end = p.bonnet_length + screen_run(p)
    deck = p.length - p.deck_length
    gutter_height = p.height - p.roof_drop
    gutter = deck - (gutter_height - p.deck_height) * float(np.tan(p.rear_rake))
    gutter = max(gutter, screen_end + 0.2)
    peak = screen_end + 0.35 * (gutter - screen_end)
    half = 0.5 * p.bonnet_length
    rise = p.cowl_height - p.nose_height
    bed = p.kind == "pickup"
    if p.kind == "van":
        # The rear is one upright face up to the roof.
        tail = [(p.length - 0.25, gutter_height + 0.02, 0.3), (p.length, gutter_height - 0.03, 0.0)]
    else:
        tail = [
            (gutter, gutter_height, 0.12 if p.rear_rake < 0.4 else 0.25),
            (deck, p.deck_height, 0.06 if bed else 0.12),
            (p.length, p.deck_height - (0.0 if bed else 0.02), 0.0),
        ]
    return Profile.rounded(
        [
            (0.0, p.nose_height, 0.0),
            (half, p.nose_height + 0.66 * rise, 0.4),
            (p.bonnet_length, p.cowl_height, 0.12),
            (screen_end, roof, 0.3),
            (peak, p.height, 0.6),
            *tail,
        ]
    )
