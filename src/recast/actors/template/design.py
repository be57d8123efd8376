"""What a template vehicle is drawn from: landmarks of its body, and the parts of its faces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

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
    front_axle_x: float
    rear_axle_x: float
    clearance_z: float
    wheel_radius: float
    tumblehome: float
    nose_bow: float
    tail_bow: float
    nose_lean: float
    tail_lean: float
    edge_radius: float
    rear_windows: bool
    side_pillars_x: tuple[float, ...]


# bonnet_z; cowl_x, _z; roof_front_x, roof_rear_x, _z; tail_x, _z; deck_z; belt_rear_z
_LANDMARKS = {
    "sedan": (0.50, 0.29, 0.665, 0.44, 0.67, 0.965, 0.835, 0.715, 0.67, 0.69),
    "hatchback": (0.49, 0.245, 0.645, 0.41, 0.855, 0.93, 0.955, 0.665, 0.62, 0.69),
    "estate": (0.50, 0.285, 0.66, 0.43, 0.875, 0.935, 0.975, 0.675, 0.65, 0.69),
    "mpv": (0.51, 0.185, 0.625, 0.355, 0.90, 0.955, 0.975, 0.62, 0.58, 0.66),
    "suv": (0.56, 0.265, 0.665, 0.395, 0.885, 0.955, 0.97, 0.655, 0.62, 0.69),
    "pickup": (0.56, 0.265, 0.66, 0.36, 0.565, 0.97, 0.595, 0.66, 0.60, 0.63),
    "van": (0.45, 0.13, 0.54, 0.27, 0.96, 0.985, 0.985, 0.55, 0.50, 0.56),
    "bus": (0.36, 0.012, 0.40, 0.03, 0.98, 0.99, 0.99, 0.52, 0.50, 0.44),
    "truck": (0.34, 0.02, 0.42, 0.06, 0.985, 0.995, 0.995, 0.45, 0.42, 0.43),
}
# front_axle_x, rear_axle_x; clearance_z, wheel_radius, tumblehome; nose_bow, tail_bow; nose_lean,
# tail_lean; edge_radius
_SHAPES = {
    "sedan": (0.185, 0.795, 0.13, 0.31, 0.17, 0.24, 0.14, 0.10, 0.08, 0.14),
    "hatchback": (0.185, 0.81, 0.13, 0.31, 0.17, 0.24, 0.14, 0.10, 0.04, 0.14),
    "estate": (0.185, 0.79, 0.13, 0.31, 0.17, 0.24, 0.14, 0.10, 0.04, 0.14),
    "mpv": (0.185, 0.82, 0.13, 0.31, 0.15, 0.24, 0.14, 0.14, 0.04, 0.14),
    "suv": (0.185, 0.795, 0.17, 0.36, 0.15, 0.24, 0.14, 0.06, 0.04, 0.14),
    "pickup": (0.185, 0.795, 0.18, 0.37, 0.13, 0.24, 0.05, 0.05, 0.04, 0.10),
    "van": (0.17, 0.77, 0.10, 0.34, 0.11, 0.24, 0.06, 0.20, 0.04, 0.14),
    "bus": (0.22, 0.72, 0.09, 0.48, 0.06, 0.14, 0.08, 0.02, 0.04, 0.12),
    "truck": (0.16, 0.76, 0.12, 0.48, 0.03, 0.10, 0.02, 0.02, 0.04, 0.07),
}
# rear_windows, side_pillars_x
_WINDOWS: dict[str, tuple[bool, tuple[float, ...]]] = {
    "sedan": (True, (0.515, 0.70)),
    "hatchback": (True, (0.51, 0.74)),
    "estate": (True, (0.505, 0.70)),
    "mpv": (True, (0.485, 0.73)),
    "suv": (True, (0.49, 0.71)),
    "pickup": (True, (0.46,)),
    "van": (False, (0.38,)),
    "bus": (True, (0.16, 0.30, 0.44, 0.58, 0.72, 0.86)),
    "truck": (False, (0.19,)),
}
# lamp_low, lamp_high, lamp_inner
_REARS = {
    "sedan": (0.49, 0.62, 0.60),
    "hatchback": (0.49, 0.62, 0.60),
    "estate": (0.49, 0.62, 0.60),
    "mpv": (0.50, 0.76, 0.84),
    "suv": (0.47, 0.66, 0.72),
    "pickup": (0.38, 0.57, 0.84),
    "van": (0.30, 0.50, 0.88),
    "bus": (0.24, 0.42, 0.82),
    "truck": (0.19, 0.25, 0.66),
}


@dataclass(frozen=True)
class FrontDesign:
    """Lamps, grille, bumper and plate of the front.

    Heights `*_z` are shares of the height of the bonnet's leading edge, places across are shares of
    the half width, other lengths metres.

    Attributes:
        lamp: shape of the headlamps.
        lamp_inner: inner end of the headlamps.
        lamp_wrap: metres by which they reach around the corner.
        lamp_z, lamp_height: middle at the inner end; height.
        lamp_slant: rise from the inner to the outer end, a share as of `lamp_z`.
        grille_z, grille_width, grille_height: middle of the upper grille; half widths; height.
        plate_z: middle of the number plate.
    """

    lamp: Literal["almond"] = "almond"
    lamp_inner: Annotated[float, (0.30, 0.80)] = 0.46
    lamp_wrap: Annotated[float, (0.0, 0.45)] = 0.22
    lamp_z: Annotated[float, (0.55, 1.0)] = 0.843
    lamp_height: Annotated[float, (0.04, 0.35)] = 0.132
    lamp_slant: Annotated[float, (-0.1, 0.2)] = 0.043
    grille_z: Annotated[float, (0.4, 1.0)] = 0.843
    grille_width: Annotated[float, (0.0, 0.9)] = 0.38
    grille_height: Annotated[float, (0.0, 0.6)] = 0.132
    plate_z: Annotated[float, (0.3, 0.9)] = 0.579


@dataclass(frozen=True)
class RearDesign:
    """Lamps, bumper and plate of the rear.

    Heights are shares of the vehicle's height, places across shares of the half width.

    Attributes:
        lamp_low, lamp_high: lower and upper edge of the tail lamps.
        lamp_inner: their inner end.
        lamp_wrap: metres by which they reach around the corner.
    """

    lamp_low: Annotated[float, (0.15, 0.7)] = 0.49
    lamp_high: Annotated[float, (0.2, 0.95)] = 0.62
    lamp_inner: Annotated[float, (0.0, 0.92)] = 0.60
    lamp_wrap: Annotated[float, (0.0, 0.45)] = 0.20


@dataclass(frozen=True)
class VehicleDesign:
    """What a template vehicle looks like, but for its paint and its size."""

    proportions: Proportions
    front: FrontDesign = FrontDesign()
    rear: RearDesign = RearDesign()


STYLES = {
    style: VehicleDesign(
        Proportions(*_LANDMARKS[style], *_SHAPES[style], *_WINDOWS[style]),
        rear=RearDesign(*_REARS[style]),
    )
    for style in _LANDMARKS
}
"""Body styles, drawn by eye from side views of common cars."""


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
        "sedan": (4.65, 1.45),
        "hatchback": (4.0, 1.48),
        "estate": (4.6, 1.47),
        "mpv": (4.2, 1.63),
        "suv": (4.55, 1.70),
        "pickup": (5.4, 1.85),
    }
    costs = {
        style: ((length - usual[0]) / 0.4) ** 2 + ((height - usual[1]) / 0.12) ** 2
        for style, usual in typical.items()
    }
    least = min(costs.values())
    return {style: cost - least for style, cost in costs.items() if cost - least < 5.0}
