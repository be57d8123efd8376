"""Where a vehicle's bonnet, windscreen, roof and wheels lie, from its class and box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Proportions:
    """Side-view landmarks of a body style.

    `*_x` are fractions of the length behind the front bumper, `*_z` fractions of the height above
    the ground; the others are metres for a body 1.75 m wide unless said otherwise.

    Attributes:
        bonnet_z: leading edge of the bonnet.
        cowl_x, cowl_z: base of the windscreen.
        roof_front_x, roof_rear_x, roof_rear_z: ends of the roof; its top is at 1.
        tail_x, tail_z: base of the rear window.
        deck_z: rear end of the boot lid, or of the shelf below the rear window.
        belt_rear_z: window sill at the rear; at the front it is `cowl_z`.
        front_axle_x, rear_axle_x: wheel centres.
        clearance_z: underside.
        wheel_radius: metres.
        tumblehome: how far each side window leans inward at the roof.
        nose_bow, tail_bow: how far the corners lie behind the middle of the bumper.
        nose_lean, tail_lean: how far the fascia leans back between bumper and bonnet or deck.
        edge_radius: rounding of the roof edges.
        rear_windows: whether there is side glass behind the front doors.
        side_pillars_x: pillars between side windows, B first.
        tail_lamp_z: lower and upper edge of the tail lamps.
        tail_lamp_inner: their inner end, as a fraction of the half width.
    """

    bonnet_z: float
    cowl_x: float
    cowl_z: float
    roof_front_x: float
    roof_rear_x: float
    roof_rear_z: float
    tail_x: float
    tail_z: float
    deck_z: float
    belt_rear_z: float
    front_axle_x: float = 0.185
    rear_axle_x: float = 0.795
    clearance_z: float = 0.13
    wheel_radius: float = 0.31
    tumblehome: float = 0.17
    nose_bow: float = 0.24
    tail_bow: float = 0.14
    nose_lean: float = 0.10
    tail_lean: float = 0.04
    edge_radius: float = 0.14
    rear_windows: bool = True
    side_pillars_x: tuple[float, ...] = (0.50, 0.71)
    tail_lamp_z: tuple[float, float] = (0.49, 0.62)
    tail_lamp_inner: float = 0.60


STYLES: dict[str, Proportions] = {
    "sedan": Proportions(
        bonnet_z=0.50, cowl_x=0.29, cowl_z=0.665, roof_front_x=0.44, roof_rear_x=0.67,
        roof_rear_z=0.965, tail_x=0.835, tail_z=0.715, deck_z=0.67, belt_rear_z=0.69,
        side_pillars_x=(0.515, 0.70), tail_lean=0.08,
    ),
    "hatchback": Proportions(
        bonnet_z=0.49, cowl_x=0.245, cowl_z=0.645, roof_front_x=0.41, roof_rear_x=0.855,
        roof_rear_z=0.93, tail_x=0.955, tail_z=0.665, deck_z=0.62, belt_rear_z=0.69,
        rear_axle_x=0.81, side_pillars_x=(0.51, 0.74),
    ),
    "estate": Proportions(
        bonnet_z=0.50, cowl_x=0.285, cowl_z=0.66, roof_front_x=0.43, roof_rear_x=0.875,
        roof_rear_z=0.935, tail_x=0.975, tail_z=0.675, deck_z=0.65, belt_rear_z=0.69,
        side_pillars_x=(0.505, 0.70), rear_axle_x=0.79,
    ),
    "mpv": Proportions(
        bonnet_z=0.51, cowl_x=0.185, cowl_z=0.625, roof_front_x=0.355, roof_rear_x=0.90,
        roof_rear_z=0.955, tail_x=0.975, tail_z=0.62, deck_z=0.58, belt_rear_z=0.66,
        tumblehome=0.15, rear_axle_x=0.82, side_pillars_x=(0.485, 0.73), nose_lean=0.14,
        tail_lamp_z=(0.50, 0.76), tail_lamp_inner=0.84,
    ),
    "suv": Proportions(
        bonnet_z=0.56, cowl_x=0.265, cowl_z=0.665, roof_front_x=0.395, roof_rear_x=0.885,
        roof_rear_z=0.955, tail_x=0.97, tail_z=0.655, deck_z=0.62, belt_rear_z=0.69,
        clearance_z=0.17, wheel_radius=0.36, tumblehome=0.15, nose_lean=0.06,
        side_pillars_x=(0.49, 0.71), tail_lamp_z=(0.47, 0.66), tail_lamp_inner=0.72,
    ),
    "pickup": Proportions(
        bonnet_z=0.56, cowl_x=0.265, cowl_z=0.66, roof_front_x=0.36, roof_rear_x=0.565,
        roof_rear_z=0.97, tail_x=0.595, tail_z=0.66, deck_z=0.60, belt_rear_z=0.63,
        clearance_z=0.18, wheel_radius=0.37, tumblehome=0.13, nose_lean=0.05, tail_bow=0.05,
        edge_radius=0.10, side_pillars_x=(0.46,), tail_lamp_z=(0.38, 0.57), tail_lamp_inner=0.84,
    ),
    "van": Proportions(
        bonnet_z=0.45, cowl_x=0.13, cowl_z=0.54, roof_front_x=0.27, roof_rear_x=0.96,
        roof_rear_z=0.985, tail_x=0.985, tail_z=0.55, deck_z=0.50, belt_rear_z=0.56,
        rear_axle_x=0.77, front_axle_x=0.17, clearance_z=0.10, wheel_radius=0.34,
        tumblehome=0.11, tail_bow=0.06, edge_radius=0.14, rear_windows=False,
        side_pillars_x=(0.38,), nose_lean=0.20, tail_lamp_z=(0.30, 0.50), tail_lamp_inner=0.88,
    ),
    "bus": Proportions(
        bonnet_z=0.36, cowl_x=0.012, cowl_z=0.40, roof_front_x=0.03, roof_rear_x=0.98,
        roof_rear_z=0.99, tail_x=0.99, tail_z=0.52, deck_z=0.50, belt_rear_z=0.44,
        rear_axle_x=0.72, front_axle_x=0.22, clearance_z=0.09, wheel_radius=0.48,
        tumblehome=0.06, nose_bow=0.14, tail_bow=0.08, nose_lean=0.02, edge_radius=0.12,
        side_pillars_x=(0.16, 0.30, 0.44, 0.58, 0.72, 0.86), tail_lamp_z=(0.24, 0.42),
        tail_lamp_inner=0.82,
    ),
    "truck": Proportions(
        bonnet_z=0.34, cowl_x=0.02, cowl_z=0.42, roof_front_x=0.06, roof_rear_x=0.985,
        roof_rear_z=0.995, tail_x=0.995, tail_z=0.45, deck_z=0.42, belt_rear_z=0.43,
        rear_axle_x=0.76, front_axle_x=0.16, clearance_z=0.12, wheel_radius=0.48,
        tumblehome=0.03, nose_bow=0.10, tail_bow=0.02, nose_lean=0.02, edge_radius=0.07,
        rear_windows=False, side_pillars_x=(0.19,), tail_lamp_z=(0.19, 0.25),
        tail_lamp_inner=0.66,
    ),
}  # fmt: skip
"""Body styles, drawn by eye from side views of common cars."""

# Fitted to the evidence: those landmarks that a LiDAR cloud of one or two sides can tell.
FITTED = (
    "bonnet_z", "cowl_x", "cowl_z", "roof_front_x", "roof_rear_x", "roof_rear_z", "tail_x",
    "tail_z", "deck_z", "tumblehome", "tail_bow", "tail_lean",
)  # fmt: skip


def candidate_styles(category: str, size: ArrayLike) -> dict[str, float]:
    """Body styles a labelled vehicle may have, each with a prior cost (0 = most likely).

    Args:
        category: the track's class; everything that is not van, truck or bus counts as a car.
        size: (3,) length, width, height in metres.
    """
    length, _, height = np.asarray(size, np.float64)
    fixed = {"van": "van", "bus": "bus", "tram": "bus", "truck": "truck"}
    if category in fixed:
        return {fixed[category]: 0.0}
    # typical (length, height) of each style; the cost is the squared distance in units of spread
    typical = {
        "sedan": (4.65, 1.45), "hatchback": (4.0, 1.48), "estate": (4.6, 1.47),
        "mpv": (4.2, 1.63), "suv": (4.55, 1.70), "pickup": (5.4, 1.85),
    }  # fmt: skip
    costs = {
        style: ((length - usual[0]) / 0.4) ** 2 + ((height - usual[1]) / 0.12) ** 2
        for style, usual in typical.items()
    }
    least = min(costs.values())
    return {style: cost - least for style, cost in costs.items() if cost - least < 5.0}
