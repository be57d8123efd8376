"""What a template vehicle is drawn from: landmarks of its body, and the parts of its faces.

Numbers are annotated with their limits, choices are `Literal` or `bool`: a design can be encoded
as a vector from these annotations alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, get_args, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array


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
    """

    bonnet_z: Annotated[float, (0.28, 0.66)]
    cowl_x: Annotated[float, (0.0, 0.42)]
    cowl_z: Annotated[float, (0.34, 0.78)]
    roof_front_x: Annotated[float, (0.0, 0.58)]
    roof_rear_x: Annotated[float, (0.46, 1.0)]
    roof_rear_z: Annotated[float, (0.86, 1.0)]
    tail_x: Annotated[float, (0.52, 1.02)]
    tail_z: Annotated[float, (0.38, 0.84)]
    deck_z: Annotated[float, (0.36, 0.80)]
    belt_rear_z: Annotated[float, (0.38, 0.80)]
    front_axle_x: Annotated[float, (0.10, 0.28)]
    rear_axle_x: Annotated[float, (0.64, 0.92)]
    clearance_z: Annotated[float, (0.06, 0.24)]
    wheel_radius: Annotated[float, (0.24, 0.54)]
    tumblehome: Annotated[float, (0.0, 0.30)]
    nose_bow: Annotated[float, (0.04, 0.36)]
    tail_bow: Annotated[float, (0.0, 0.30)]
    nose_lean: Annotated[float, (0.0, 0.28)]
    tail_lean: Annotated[float, (-0.06, 0.22)]
    edge_radius: Annotated[float, (0.04, 0.20)]


@dataclass(frozen=True)
class FrontDesign:
    """Lamps, grille, bumper and plate of the front.

    Heights `*_z` are shares of the height of the bonnet's leading edge, places across and widths
    shares of the half width, other lengths metres.

    Attributes:
        lamp: shape of the headlamps; "split" is a line of LEDs above a separate lamp.
        lamp_inner: inner end of the headlamps.
        lamp_wrap: metres by which they reach around the corner.
        lamp_z, lamp_height: middle at the inner end; height.
        lamp_slant: rise from the inner to the outer end, a share as of `lamp_z`.
        lamp_dark: whether the housing is black, not clear.
        amber: whether an orange indicator shows in the lamp.
        grille: outline of the upper grille; "full" reaches down to the bumper's lower edge.
        grille_z, grille_width, grille_height: middle; half width; height.
        bars: pattern of the grille.
        frame: what the grille is framed in.
        intake_width, intake_height: half width of the lower intake; height.
        fog: whether there are fog lamps.
        bumper: lower part in body colour, in black plastic, or with a silver skid plate below.
        plate_z: middle of the number plate.
        plate: format of both number plates, 0.52 by 0.115 m or 0.33 by 0.165 m.
    """

    lamp: Literal["almond", "round", "slit", "rectangle", "tall", "split"] = "almond"
    lamp_inner: Annotated[float, (0.30, 0.80)] = 0.50
    lamp_wrap: Annotated[float, (0.0, 0.45)] = 0.22
    lamp_z: Annotated[float, (0.55, 1.0)] = 0.86
    lamp_height: Annotated[float, (0.04, 0.35)] = 0.14
    lamp_slant: Annotated[float, (-0.1, 0.25)] = 0.06
    lamp_dark: bool = False
    amber: bool = False
    grille: Literal["none", "bar", "trapezoid", "hexagon", "full"] = "trapezoid"
    grille_z: Annotated[float, (0.4, 1.0)] = 0.84
    grille_width: Annotated[float, (0.1, 0.9)] = 0.42
    grille_height: Annotated[float, (0.03, 0.6)] = 0.14
    bars: Literal["horizontal", "vertical", "mesh"] = "horizontal"
    frame: Literal["chrome", "dark", "painted"] = "dark"
    intake_width: Annotated[float, (0.2, 0.9)] = 0.58
    intake_height: Annotated[float, (0.03, 0.3)] = 0.11
    fog: bool = True
    bumper: Literal["body", "black", "skid"] = "body"
    plate_z: Annotated[float, (0.3, 0.9)] = 0.58
    plate: Literal["long", "short"] = "long"


@dataclass(frozen=True)
class RearDesign:
    """Lamps, bumper, window and plate of the rear.

    Heights are shares of the vehicle's height, places across shares of the half width.

    Attributes:
        lamp: outline of the tail lamps: corner block, upright beside the gate, wide and low, or
            joined by a strip across the gate.
        lamp_low, lamp_high: lower and upper edge of the tail lamps.
        lamp_inner: their inner end.
        lamp_wrap: metres by which they reach around the corner.
        indicator: colour of the indicator in the lamp.
        plate_z: middle of the number plate, on the gate if above `bumper_z`.
        bumper_z: upper edge of the bumper.
        apron_z: upper edge of its black lower part.
        window_width: half width of the rear window, a share of what fits; the least means none.
        window_low: lower edge of the rear window, metres above the panel's lower edge.
        spoiler: whether a spoiler darkens the upper edge of the rear window.
        exhaust: tail pipes that show.
        chrome: whether a strip of chrome is above the plate.
    """

    lamp: Literal["block", "upright", "wide", "strip"] = "block"
    lamp_low: Annotated[float, (0.15, 0.7)] = 0.49
    lamp_high: Annotated[float, (0.2, 0.95)] = 0.62
    lamp_inner: Annotated[float, (0.2, 0.92)] = 0.60
    lamp_wrap: Annotated[float, (0.0, 0.45)] = 0.20
    indicator: Literal["red", "clear", "amber"] = "red"
    plate_z: Annotated[float, (0.15, 0.7)] = 0.47
    bumper_z: Annotated[float, (0.12, 0.5)] = 0.38
    apron_z: Annotated[float, (0.08, 0.4)] = 0.20
    window_width: Annotated[float, (0.6, 1.0)] = 0.95
    window_low: Annotated[float, (0.0, 0.25)] = 0.03
    spoiler: bool = False
    exhaust: Literal["none", "single", "double"] = "single"
    chrome: bool = False


@dataclass(frozen=True)
class SideDesign:
    """Windows, doors and trim of the sides; metres unless said otherwise.

    Attributes:
        panes: front doors alone, with panes behind them that no door has, two doors, two doors
            and a quarter pane, or a row of equal panes.
        pillar_b_x, pillar_c_x: pillars between the panes, fractions of the length behind the front.
        pillar_width: half width of the first one.
        rear_pillar: width of the pillar beside the rear window.
        kick: rise of the window sill behind the last pillar.
        pane_top: roof edge above the panes.
        frame: edge of the windows in chrome or in black.
        dark_glass: whether the panes behind the front doors are dark.
        black_pillars: whether the pillars between the panes are black, not in body colour.
        cladding: black plastic around the arches and on the sills, 0 for none.
        rub_strip: whether a strip protects the doors.
        handles: what door handles are made of.
        rails: roof rails.
        black_roof: whether the roof is black.
        sliding: whether the rear door slides on a rail.
    """

    panes: Literal["front", "quarter", "two", "three", "row"] = "two"
    pillar_b_x: Annotated[float, (0.14, 0.65)] = 0.51
    pillar_c_x: Annotated[float, (0.28, 0.88)] = 0.72
    pillar_width: Annotated[float, (0.02, 0.09)] = 0.05
    rear_pillar: Annotated[float, (0.05, 0.40)] = 0.14
    kick: Annotated[float, (0.0, 0.20)] = 0.0
    pane_top: Annotated[float, (0.03, 0.14)] = 0.075
    frame: Literal["dark", "chrome"] = "dark"
    dark_glass: bool = False
    black_pillars: bool = True
    cladding: Annotated[float, (0.0, 0.12)] = 0.0
    rub_strip: bool = False
    handles: Literal["painted", "black", "chrome"] = "painted"
    rails: Literal["none", "black", "silver"] = "none"
    black_roof: bool = False
    sliding: bool = False


@dataclass(frozen=True)
class RimDesign:
    """Metal of the wheels.

    Attributes:
        kind: light alloy, dark alloy, or a steel wheel with its cover.
        spokes: how many; rounded.
        spoke_width: share of the spokes in the circle.
        share: radius of the rim over that of the wheel.
        pairs: whether spokes are split in two.
    """

    kind: Literal["alloy", "dark", "cover"] = "alloy"
    spokes: Annotated[float, (5.0, 16.0)] = 10.0
    spoke_width: Annotated[float, (0.25, 0.65)] = 0.42
    share: Annotated[float, (0.56, 0.78)] = 0.66
    pairs: bool = False


@dataclass(frozen=True)
class VehicleDesign:
    """What a template vehicle looks like, but for its paint and its size."""

    proportions: Proportions
    front: FrontDesign = FrontDesign()
    rear: RearDesign = RearDesign()
    side: SideDesign = SideDesign()
    rim: RimDesign = RimDesign()


# bonnet_z; cowl_x, _z; roof_front_x, roof_rear_x, _z; tail_x, _z; deck_z; belt_rear_z
# front_axle_x, rear_axle_x; clearance_z, wheel_radius, tumblehome; nose_bow, tail_bow; nose_lean,
# tail_lean; edge_radius
_BODIES = {
    "sedan": """0.525 0.285 0.67 0.44 0.67 0.965 0.835 0.715 0.67 0.69
        0.19 0.795 0.125 0.33 0.17 0.24 0.14 0.075 0.08 0.14""",
    "hatchback": """0.525 0.245 0.655 0.41 0.855 0.93 0.955 0.665 0.62 0.69
        0.19 0.815 0.125 0.32 0.17 0.24 0.14 0.075 0.04 0.14""",
    "estate": """0.525 0.28 0.665 0.43 0.875 0.935 0.975 0.675 0.65 0.69
        0.19 0.79 0.125 0.33 0.17 0.24 0.14 0.075 0.04 0.14""",
    "mpv": """0.51 0.185 0.625 0.355 0.90 0.955 0.975 0.62 0.58 0.66
        0.185 0.82 0.12 0.325 0.15 0.24 0.14 0.10 0.04 0.14""",
    "suv": """0.59 0.265 0.675 0.395 0.885 0.955 0.97 0.655 0.62 0.69
        0.185 0.795 0.17 0.365 0.15 0.20 0.14 0.05 0.04 0.13""",
    "coupe": """0.52 0.315 0.67 0.475 0.66 0.955 0.93 0.735 0.70 0.74
        0.185 0.79 0.11 0.33 0.20 0.26 0.18 0.10 0.05 0.16""",
    "coupe-suv": """0.60 0.275 0.68 0.41 0.70 0.955 0.95 0.715 0.66 0.71
        0.185 0.795 0.16 0.37 0.16 0.22 0.15 0.05 0.05 0.14""",
    "city": """0.505 0.20 0.63 0.365 0.885 0.945 0.97 0.645 0.60 0.68
        0.17 0.835 0.12 0.29 0.15 0.24 0.14 0.09 0.03 0.14""",
    "kei": """0.52 0.145 0.585 0.275 0.94 0.97 0.98 0.60 0.56 0.61
        0.165 0.875 0.10 0.275 0.075 0.13 0.06 0.05 0.01 0.09""",
    "one-box": """0.545 0.17 0.595 0.345 0.935 0.965 0.975 0.58 0.54 0.60
        0.19 0.80 0.10 0.34 0.11 0.20 0.10 0.06 0.03 0.11""",
    "pickup": """0.585 0.265 0.665 0.36 0.565 0.97 0.595 0.66 0.60 0.63
        0.185 0.795 0.18 0.37 0.13 0.22 0.05 0.05 0.02 0.10""",
    "van": """0.45 0.13 0.54 0.27 0.96 0.985 0.985 0.55 0.50 0.56
        0.17 0.77 0.10 0.34 0.11 0.22 0.06 0.16 0.02 0.12""",
    "bus": """0.36 0.012 0.40 0.03 0.98 0.99 0.99 0.52 0.50 0.44
        0.22 0.72 0.09 0.48 0.06 0.14 0.08 0.02 0.04 0.12""",
    "truck": """0.34 0.02 0.42 0.06 0.985 0.995 0.995 0.45 0.42 0.43
        0.16 0.76 0.12 0.48 0.03 0.10 0.02 0.02 0.02 0.07""",
}
# length, width, height in metres; spread of the length; cost of how rare the style is
_SIZES = {
    "sedan": (4.65, 1.80, 1.45, 0.25, 0.0),
    "hatchback": (4.10, 1.76, 1.48, 0.20, 0.0),
    "estate": (4.60, 1.80, 1.47, 0.20, 0.0),
    "mpv": (4.30, 1.80, 1.63, 0.20, 0.3),
    "suv": (4.45, 1.83, 1.68, 0.22, 0.0),
    "coupe": (4.45, 1.82, 1.36, 0.20, 1.0),
    "coupe-suv": (4.60, 1.87, 1.61, 0.20, 1.0),
    "city": (3.60, 1.64, 1.50, 0.15, 0.3),
    "kei": (3.395, 1.475, 1.70, 0.03, 0.5),
    "one-box": (4.85, 1.83, 1.88, 0.22, 0.3),
    "pickup": (5.35, 1.88, 1.83, 0.25, 0.0),
    "van": (5.40, 2.00, 2.35, 0.45, 0.0),
    "bus": (11.8, 2.55, 3.15, 0.6, 0.0),
    "truck": (7.6, 2.50, 3.30, 0.8, 0.0),
}
# tail lamp: low, high, inner; plate_z, bumper_z, apron_z. Side: panes, B, C, rear_pillar
_FACES: dict[str, tuple[Any, ...]] = {
    "sedan": (0.50, 0.63, 0.58, 0.47, 0.37, 0.19, "two", 0.515, 0.70, 0.13),
    "hatchback": (0.49, 0.63, 0.66, 0.46, 0.37, 0.20, "two", 0.51, 0.74, 0.15),
    "estate": (0.49, 0.65, 0.66, 0.46, 0.37, 0.20, "three", 0.505, 0.70, 0.09),
    "mpv": (0.48, 0.68, 0.74, 0.44, 0.34, 0.19, "three", 0.485, 0.73, 0.10),
    "suv": (0.49, 0.65, 0.68, 0.46, 0.36, 0.24, "three", 0.49, 0.71, 0.10),
    "coupe": (0.56, 0.66, 0.50, 0.36, 0.40, 0.21, "quarter", 0.56, 0.70, 0.16),
    "coupe-suv": (0.55, 0.64, 0.56, 0.40, 0.38, 0.24, "two", 0.50, 0.72, 0.14),
    "city": (0.46, 0.62, 0.72, 0.44, 0.35, 0.19, "two", 0.50, 0.75, 0.16),
    "kei": (0.38, 0.55, 0.84, 0.37, 0.27, 0.15, "three", 0.44, 0.71, 0.10),
    "one-box": (0.44, 0.56, 0.70, 0.42, 0.27, 0.13, "three", 0.42, 0.69, 0.07),
    "pickup": (0.38, 0.57, 0.84, 0.30, 0.34, 0.20, "two", 0.43, 0.56, 0.10),
    "van": (0.30, 0.50, 0.88, 0.27, 0.23, 0.14, "front", 0.34, 0.60, 0.10),
    "bus": (0.24, 0.42, 0.82, 0.24, 0.20, 0.12, "row", 0.16, 0.30, 0.10),
    "truck": (0.19, 0.25, 0.66, 0.22, 0.17, 0.12, "front", 0.16, 0.30, 0.10),
}
# Weights of the front's lamps (in the order of their `Literal`), grilles, bumpers; tail lamps.
_CHOICES = {
    "sedan": ((5, 0.3, 3, 2, 1, 0.3), (0.5, 2, 5, 3, 1), (9, 0.3, 0), (6, 0.3, 4, 2)),
    "hatchback": ((4, 0.8, 2, 1, 4, 0.5), (1, 4, 3, 3, 0.5), (8, 1.5, 0.3), (7, 2, 1, 1)),
    "estate": ((5, 0.2, 3, 2, 1, 0.3), (0.3, 2, 5, 3, 1), (9, 0.5, 0.5), (6, 3, 2, 1)),
    "mpv": ((4, 0.2, 2, 1, 4, 0.6), (0.5, 4, 4, 2, 1), (9, 1, 0.3), (4, 5, 2, 1)),
    "suv": ((3, 0.7, 2, 4, 1, 2.5), (0.3, 2, 4, 4, 1.5), (2, 3, 4), (6, 2, 3, 2)),
    "coupe": ((4, 1, 4, 1, 1, 0.3), (0.5, 2, 3, 4, 1), (9, 0.2, 0), (3, 0.3, 5, 3)),
    "coupe-suv": ((3, 0.2, 4, 1, 0.5, 3), (0.6, 2, 3, 4, 2), (3, 2, 4), (2, 0.3, 5, 4)),
    "city": ((3, 2.5, 0.5, 1, 4, 0.3), (2, 4, 3, 2, 0.5), (7, 2, 0.3), (6, 4, 0.2, 0.3)),
    "kei": ((2, 2, 1, 4, 3, 0.5), (2, 4, 2, 1, 1), (9, 0.5, 0), (2, 8, 0.2, 0.2)),
    "one-box": ((3, 0, 3, 1, 1, 3), (0.5, 2, 2, 1.5, 4), (9, 0.3, 0.2), (3, 3, 4, 2)),
    "pickup": ((2, 0.5, 1, 5, 1, 2), (0, 2, 4, 4, 2), (2, 4, 3), (0.5, 9, 0, 0)),
    "van": ((1, 0.2, 0.2, 3, 6, 0.2), (0.3, 5, 3, 1, 0.3), (3, 6, 0), (0.3, 9, 0, 0)),
    "bus": ((1, 3, 0.5, 4, 0.5, 0), (3, 4, 1, 0, 0), (8, 2, 0), (1, 8, 0, 0)),
    "truck": ((0.5, 1, 0.2, 7, 1, 0), (0, 1, 5, 2, 2), (2, 7, 0), (5, 1, 0, 0)),
}
# The age (0 new, 1 thirty years) at which each choice was most usual; others are timeless.
_ERAS = {
    **{"almond": 0.5, "round": 0.75, "slit": 0.05, "rectangle": 0.75, "tall": 0.45, "split": 0.0},
    **{"hexagon": 0.2, "full": 0.1, "wide": 0.2, "strip": 0.0, "black": 0.7},
}
# lamp_inner, lamp_wrap, lamp_z, lamp_height, lamp_slant
_LAMPS = {
    "almond": (0.50, 0.24, 0.855, 0.150, 0.06),
    "round": (0.56, 0.04, 0.84, 0.19, 0.0),
    "slit": (0.47, 0.28, 0.89, 0.085, 0.05),
    "rectangle": (0.50, 0.14, 0.85, 0.165, 0.02),
    "tall": (0.56, 0.22, 0.84, 0.22, 0.14),
    "split": (0.50, 0.24, 0.93, 0.055, 0.02),
}
# grille_z, grille_width, grille_height; plate_z; intake_width, intake_height
_GRILLES = {
    "none": (0.86, 0.30, 0.05, 0.60, 0.66, 0.12),
    "bar": (0.87, 0.44, 0.075, 0.62, 0.64, 0.15),
    "trapezoid": (0.83, 0.44, 0.16, 0.56, 0.60, 0.11),
    "hexagon": (0.77, 0.42, 0.26, 0.50, 0.60, 0.08),
    "full": (0.66, 0.62, 0.38, 0.52, 0.55, 0.05),
}
_WIDEST_KEI = 1.58  # metres: 1.48 by law, and what a label is off by
_USED = 0.35  # age and price of what is most usual on roads
_CAR_STYLES = tuple(style for style in _BODIES if style not in ("van", "bus", "truck"))


def _read_limits(part: type) -> dict[str, tuple[float, float]]:
    hints = get_type_hints(part, include_extras=True).items()
    return {name: hint.__metadata__[0] for name, hint in hints if hasattr(hint, "__metadata__")}


_PARTS = (Proportions, FrontDesign, RearDesign, SideDesign, RimDesign)
_LIMITS: dict[type, dict[str, tuple[float, float]]] = {part: _read_limits(part) for part in _PARTS}
_OPTIONS: dict[type, dict[str, tuple[Any, ...]]] = {
    part: {
        name: get_args(hint) or (False, True)
        for name, hint in get_type_hints(part).items()
        if name not in _LIMITS[part]
    }
    for part in _PARTS
}


def limits(part: type) -> dict[str, tuple[float, float]]:
    """Lower and upper limit of each number of a design's part, such as `FrontDesign`."""
    return _LIMITS[part]


def options(part: type) -> dict[str, tuple[Any, ...]]:
    """Values of each choice of a design's part."""
    return _OPTIONS[part]


def likely_design(style: str, size: ArrayLike) -> VehicleDesign:
    """The design that is most usual for a style and a size (3,) in metres."""
    return _design(style, np.asarray(size, np.float64), None)


def sample_design(style: str, size: ArrayLike, rng: np.random.Generator) -> VehicleDesign:
    """A random design of a style and a size (3,) in metres; its parts share an age and a price."""
    return _design(style, np.asarray(size, np.float64), rng)


def sample_size(style: str, rng: np.random.Generator) -> Array:
    """Random length, width and height (3,) of a vehicle of a style, metres."""
    length, width, height, spread, _ = _SIZES[style]
    longer = float(np.clip(rng.normal(), -2.0, 2.0)) * spread / length
    other = 1 + 0.025 * np.clip(rng.normal(size=2), -2.0, 2.0)
    if style == "kei":  # limited by law
        return np.array([length * (1 + longer), width, height * (1 + 2.5 * (other[1] - 1))])
    factors = np.array([1 + longer, (1 + 0.35 * longer) * other[0], (1 + 0.2 * longer) * other[1]])
    return np.array([length, width, height]) * factors


def _design(style: str, size: Array, rng: np.random.Generator | None) -> VehicleDesign:
    age, price = (_USED, _USED) if rng is None else rng.uniform(0.0, 1.0, 2)
    if style == "coupe-suv":  # a new kind of car
        age *= 0.4

    def pick(part: type, name: str, weights: tuple[float, ...]) -> Any:
        among = _OPTIONS[part][name]
        eras = np.array([_ERAS.get(option, age) for option in among])
        shares = np.array(weights, np.float64) * np.exp(-(((eras - age) / 0.3) ** 2))
        best = (
            int(np.argmax(shares))
            if rng is None
            else int(rng.choice(len(among), p=shares / shares.sum()))
        )
        return among[best]

    def chance(probability: float) -> bool:
        return bool((0.5 if rng is None else rng.uniform()) < probability)

    lamps, grilles, bumpers, tails = _CHOICES[style]
    face = _FACES[style]
    high = style in ("suv", "coupe-suv", "pickup")
    working = style in ("van", "bus", "truck")
    scale = float(np.clip(size[2] / 1.5, 0.95, 1.35)) if not working else 1.3

    lamp = pick(FrontDesign, "lamp", lamps)
    grille = pick(FrontDesign, "grille", grilles)
    inner, wrap, lamp_z, lamp_height, slant = _LAMPS[lamp]
    grille_z, width, height, plate_z, intake_width, intake_height = _GRILLES[grille]
    bumper = pick(FrontDesign, "bumper", bumpers)
    front = FrontDesign(
        lamp, inner, wrap * (0.5 if working else 1.0), lamp_z, lamp_height * scale, slant,
        lamp_dark=chance(0.25 + 0.6 * (age < 0.4)),
        amber=chance(1.3 * (age - 0.6)),
        grille=grille, grille_z=grille_z, grille_width=width, grille_height=height * scale,
        bars=pick(FrontDesign, "bars", (5, 1 + price, 2 + 3 * (age < 0.4))),
        frame=pick(FrontDesign, "frame", (1.5 + 3 * price, 3, 1.5)),
        intake_width=intake_width, intake_height=intake_height * scale,
        fog=chance(0.7), bumper=bumper, plate_z=plate_z,
        plate="short" if style in ("kei", "one-box") or chance(0.3) else "long",
    )  # fmt: skip
    tail = pick(RearDesign, "lamp", tails)
    low, top, inner = face[:3]
    if tail == "upright":
        low, top, inner = low - 0.02, min(top + 0.12, 0.85 if style != "pickup" else 0.57), 0.82
    elif tail != "block":
        low, top, inner = top - 0.105, top - 0.01, 0.42 if tail == "wide" else 0.60
    if working or style in ("kei", "pickup"):
        low, top, inner = face[:3]
    rear = RearDesign(
        tail, low, top, inner, 0.06 if working else 0.20,
        indicator=pick(RearDesign, "indicator", (2 + 4 * (age < 0.4), 2, 4 * age)),
        plate_z=face[3], bumper_z=face[4], apron_z=face[5],
        window_width=0.6 if style == "truck" else 0.80 if working else 0.95, window_low=0.03,
        spoiler=chance(0.7 if style not in ("sedan", "coupe", "pickup") and not working else 0.0),
        exhaust=pick(RearDesign, "exhaust", (3.0, 2.5, 3.5 * price)),
        chrome=chance(0.25 + 0.5 * price),
    )  # fmt: skip
    trim = chance(0.75 if high else 0.12 if style in ("hatchback", "estate", "city") else 0.0)
    side = SideDesign(
        panes=face[6], pillar_b_x=face[7], pillar_c_x=face[8], rear_pillar=face[9],
        pillar_width=0.05, kick=0.0 if chance(0.6) else 0.09,
        frame="chrome" if not working and chance(0.7 * price) else "dark",
        dark_glass=chance(0.55 if style in ("mpv", "suv", "kei", "one-box", "coupe-suv") else 0.2),
        black_pillars=chance(0.9),
        cladding=0.065 if trim or (working and chance(0.3)) else 0.0,
        rub_strip=chance(1.4 * (age - 0.4)) or style == "van",
        handles="black" if working or chance(age - 0.55) else
        "chrome" if chance(0.5 * price) else "painted",
        rails=pick(SideDesign, "rails", (2, 2, 2.5) if style in ("suv", "estate")
                   else (6, 1, 1) if style == "mpv" else (1, 0, 0)),
        black_roof=chance(0.12 if not working else 0.0),
        sliding=style in ("one-box", "van") or (style == "kei" and chance(0.6)),
    )  # fmt: skip
    kind = pick(
        RimDesign,
        "kind",
        (3 + 3 * price, 1.5 * (age < 0.5) + 0.3, 5 if working else 3.0 * (1 - price)),
    )
    rim = RimDesign(
        kind, {"alloy": 10.0, "dark": 5.0, "cover": 7.0}[kind],
        share=0.60 if working else 0.70 - 0.08 * age, pairs=chance(0.35),
    )  # fmt: skip
    landmarks = Proportions(*(float(value) for value in _BODIES[style].split()))
    longer = size[0] / _SIZES[style][0]
    radius = landmarks.wheel_radius * longer**0.5
    landmarks = replace(landmarks, wheel_radius=radius)
    parts = [_varied(part, rng) for part in (landmarks, front, rear, side, rim)]
    return ordered(VehicleDesign(*parts))


# Standard deviations of sampled numbers; of the others, in shares of their range.
_DEVIATIONS = {
    **dict.fromkeys(limits(Proportions), 0.013),
    **{"tumblehome": 0.02, "nose_bow": 0.03, "tail_bow": 0.02, "nose_lean": 0.02},
    **{"pillar_b_x": 0.012, "pillar_c_x": 0.015, "plate_z": 0.02, "bumper_z": 0.02},
    **{"lamp_z": 0.02, "lamp_low": 0.015, "lamp_high": 0.02, "grille_z": 0.02, "apron_z": 0.02},
    **{"rear_pillar": 0.03, "spokes": 2.5, "lamp_inner": 0.04, "tail_lean": 0.015, "kick": 0.02},
    **{"lamp_height": 0.012, "grille_height": 0.02, "pane_top": 0.01, "cladding": 0.015},
}
_DEVIATION = 0.08


def _varied(part: Any, rng: np.random.Generator | None) -> Any:
    """A part with its numbers disturbed and within their limits; zero stays zero."""
    changes = {}
    for name, (low, high) in limits(type(part)).items():
        value = part.__dict__[name]
        if rng is not None and value != 0.0:
            value += _DEVIATIONS.get(name, _DEVIATION * (high - low)) * rng.normal()
        changes[name] = float(np.clip(value, low, high))
    return replace(part, **changes)


def ordered(design: VehicleDesign) -> VehicleDesign:
    """The design with its landmarks in order and its parts apart."""
    p, rear, side = design.proportions, design.rear, design.side
    tail_z = max(p.tail_z, p.deck_z + 0.01)
    p = replace(p, tail_x=max(p.tail_x, p.roof_rear_x + 0.012), tail_z=tail_z)
    # knots of the profile must not coincide
    p = replace(p, cowl_x=max(p.cowl_x, 0.004), tail_x=min(p.tail_x, 1.012))
    rear = replace(rear, lamp_high=max(rear.lamp_high, rear.lamp_low + _LAMP))
    side = replace(side, pillar_c_x=max(side.pillar_c_x, side.pillar_b_x + _PANE))
    return replace(design, proportions=p, rear=rear, side=side)


_LAMP, _PANE = 0.05, 0.1  # least height of a tail lamp, least length of a pane, as shares


def in_order(design: VehicleDesign) -> bool:
    """Whether tail lamps have a height, and rear panes a length."""
    rear, side = design.rear, design.side
    lamp = rear.lamp_high - rear.lamp_low
    return lamp >= _LAMP - 1e-9 and side.pillar_c_x - side.pillar_b_x >= _PANE - 1e-9


STYLES = {style: likely_design(style, _SIZES[style][:3]) for style in _BODIES}
"""The most usual design of each body style, drawn by eye from common cars."""


def candidate_styles(category: str, size: ArrayLike) -> dict[str, float]:
    """Body styles a labelled vehicle may have, each with a prior cost (0 = most likely).

    Args:
        category: the track's class; everything that is not van, truck or bus counts as a car.
        size: (3,) length, width, height in metres.
    """
    length, width, height = np.asarray(size, np.float64)
    fixed = {"bus": "bus", "tram": "bus", "truck": "truck"}
    if category in fixed:
        return {fixed[category]: 0.0}
    if category == "van":  # labels of people carriers
        people = {"one-box": 0.0, "mpv": 0.5} if height < 2.05 and length < 5.3 else {}
        return {"van": 0.0, **people} if height > 1.8 else {"van": 1.0, **people}
    # the cost is the squared distance to the usual size in units of spread
    costs = {}
    for style in _CAR_STYLES:
        usual_length, usual_width, usual_height, _, rare = _SIZES[style]
        if style == "kei" and width > _WIDEST_KEI:
            continue
        costs[style] = rare + float(
            ((length - usual_length) / 0.4) ** 2
            + ((height - usual_height) / 0.12) ** 2
            + (min(width - usual_width, 0.15) / 0.2) ** 2
        )
    least = min(costs.values())
    return {style: cost - least for style, cost in costs.items() if cost - least < 5.0}
