"""Vehicles from a kind to the finished surface: typical sizes, colours, and the build itself."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from recast.core.errors import InputError
from recast.synthetic.surface import Surface, concatenate
from recast.synthetic.vehicles.bodywork import Parts
from recast.synthetic.vehicles.cars import car
from recast.synthetic.vehicles.heavy import box_truck, bus
from recast.synthetic.vehicles.parameters import KINDS, LIMITS, VehicleParameters
from recast.synthetic.vehicles.solid import Finish
from recast.synthetic.world import VehicleModel

CATEGORIES: dict[str, str] = {"van": "van", "pickup": "car", "box-truck": "truck", "bus": "bus"}
"""Kind -> category of the label; all others are "car"."""

KIND_SHARES: dict[str, float] = {
    "hatchback": 0.25,
    "sedan": 0.24,
    "estate": 0.10,
    "suv": 0.24,
    "pickup": 0.05,
    "van": 0.08,
    "box-truck": 0.025,
    "bus": 0.015,
}
"""Share of each kind on the road."""

Range = tuple[float, float]

_CAR: dict[str, Range] = {
    "tyre_width": (0.2, 0.24),
    "wedge": (0.01, 0.035),
    "shoulder": (0.01, 0.035),
    "roof_arch": (0.03, 0.06),
    "bow": (0.1, 0.2),
    "corner": (0.2, 0.3),
    "flare": (0.008, 0.022),
    "crease": (0.0, 0.022),
    "tumblehome": (0.30, 0.40),
    "lamp_width": (0.36, 0.52),
    "lamp_height": (0.11, 0.19),
    "lamp_slant": (0.02, 0.22),
    "grille_width": (0.5, 1.0),
    "grille_height": (0.07, 0.24),
    "intake_height": (0.1, 0.2),
    "rim_share": (0.62, 0.72),
}

_RANGES: dict[str, dict[str, Range]] = {
    "hatchback": _CAR
    | {
        "length": (3.75, 4.4),
        "width": (1.68, 1.82),
        "height": (1.44, 1.54),
        "wheelbase": (0.595, 0.625),
        "front_overhang": (0.185, 0.205),
        "wheel_radius": (0.3, 0.33),
        "ground_clearance": (0.15, 0.19),
        "nose_height": (0.72, 0.80),
        "cowl_height": (0.96, 1.03),
        "bonnet_length": (0.215, 0.255),
        "windscreen_rake": (0.96, 1.06),
        "rear_rake": (0.45, 0.75),
        "deck_length": (0.06, 0.14),
        "deck_height": (0.93, 1.02),
        "belt_height": (0.90, 0.97),
        "roof_drop": (0.05, 0.12),
        "tail_width": (0.2, 0.42),
        "tail_height": (0.17, 0.32),
    },
    "sedan": _CAR
    | {
        "length": (4.5, 5.0),
        "width": (1.78, 1.9),
        "height": (1.42, 1.49),
        "wheelbase": (0.58, 0.605),
        "front_overhang": (0.18, 0.2),
        "wheel_radius": (0.315, 0.35),
        "ground_clearance": (0.14, 0.17),
        "nose_height": (0.68, 0.76),
        "cowl_height": (0.93, 0.99),
        "bonnet_length": (0.245, 0.28),
        "windscreen_rake": (1.02, 1.1),
        "rear_rake": (1.0, 1.13),
        "deck_length": (0.46, 0.7),
        "deck_height": (0.98, 1.07),
        "belt_height": (0.87, 0.93),
        "roof_drop": (0.05, 0.1),
        "tail_width": (0.36, 0.6),
        "tail_height": (0.13, 0.2),
    },
    "estate": _CAR
    | {
        "length": (4.45, 4.95),
        "width": (1.78, 1.88),
        "height": (1.44, 1.52),
        "wheelbase": (0.575, 0.60),
        "front_overhang": (0.185, 0.2),
        "wheel_radius": (0.315, 0.345),
        "ground_clearance": (0.14, 0.18),
        "nose_height": (0.69, 0.77),
        "cowl_height": (0.94, 1.0),
        "bonnet_length": (0.23, 0.26),
        "windscreen_rake": (1.0, 1.08),
        "rear_rake": (0.5, 0.8),
        "deck_length": (0.07, 0.12),
        "deck_height": (0.95, 1.0),
        "belt_height": (0.88, 0.94),
        "roof_drop": (0.04, 0.08),
        "tail_width": (0.3, 0.5),
        "tail_height": (0.16, 0.26),
    },
    "suv": _CAR
    | {
        "length": (4.35, 4.95),
        "width": (1.82, 1.98),
        "height": (1.62, 1.8),
        "wheelbase": (0.575, 0.605),
        "front_overhang": (0.18, 0.195),
        "wheel_radius": (0.345, 0.39),
        "ground_clearance": (0.2, 0.26),
        "nose_height": (0.88, 0.99),
        "cowl_height": (1.08, 1.16),
        "bonnet_length": (0.225, 0.265),
        "windscreen_rake": (0.86, 1.0),
        "rear_rake": (0.35, 0.65),
        "deck_length": (0.05, 0.12),
        "deck_height": (1.05, 1.14),
        "belt_height": (1.03, 1.12),
        "roof_drop": (0.03, 0.09),
        "tail_width": (0.24, 0.5),
        "tail_height": (0.15, 0.32),
        "grille_height": (0.14, 0.3),
        "tumblehome": (0.24, 0.34),
        "flare": (0.015, 0.035),
        "tyre_width": (0.22, 0.26),
    },
    "pickup": _CAR
    | {
        "length": (5.15, 5.65),
        "width": (1.84, 2.02),
        "height": (1.76, 1.92),
        "wheelbase": (0.59, 0.615),
        "front_overhang": (0.165, 0.18),
        "wheel_radius": (0.37, 0.41),
        "ground_clearance": (0.26, 0.34),
        "nose_height": (1.0, 1.1),
        "cowl_height": (1.16, 1.24),
        "bonnet_length": (0.225, 0.25),
        "windscreen_rake": (0.8, 0.95),
        "rear_rake": (0.12, 0.3),
        "deck_length": (1.45, 1.75),
        "deck_height": (1.1, 1.18),
        "belt_height": (1.1, 1.17),
        "roof_drop": (0.02, 0.05),
        "tail_width": (0.14, 0.2),
        "tail_height": (0.3, 0.45),
        "grille_height": (0.22, 0.36),
        "tumblehome": (0.2, 0.28),
        "flare": (0.02, 0.045),
        "tyre_width": (0.24, 0.29),
        "wedge": (0.0, 0.01),
        "corner": (0.14, 0.22),
    },
    "van": _CAR
    | {
        "length": (4.7, 6.0),
        "width": (1.88, 2.05),
        "height": (1.92, 2.6),
        "wheelbase": (0.59, 0.625),
        "front_overhang": (0.165, 0.185),
        "wheel_radius": (0.33, 0.36),
        "ground_clearance": (0.18, 0.24),
        "nose_height": (0.92, 1.02),
        "cowl_height": (1.2, 1.3),
        "bonnet_length": (0.115, 0.155),
        "windscreen_rake": (0.68, 0.85),
        "rear_rake": (0.05, 0.12),
        "deck_length": (0.02, 0.03),
        "deck_height": (1.1, 1.2),
        "belt_height": (1.13, 1.22),
        "roof_drop": (0.01, 0.04),
        "tail_width": (0.12, 0.17),
        "tail_height": (0.4, 0.7),
        "lamp_height": (0.18, 0.27),
        "lamp_width": (0.3, 0.42),
        "tumblehome": (0.06, 0.14),
        "wedge": (0.0, 0.005),
        "shoulder": (0.0, 0.015),
        "corner": (0.12, 0.2),
        "bow": (0.12, 0.22),
        "roof_arch": (0.02, 0.05),
        "rim_share": (0.56, 0.62),
    },
    "box-truck": _CAR
    | {
        "length": (6.2, 7.8),
        "width": (2.15, 2.45),
        "height": (2.9, 3.4),
        "wheelbase": (0.53, 0.58),
        "front_overhang": (0.13, 0.16),
        "wheel_radius": (0.38, 0.44),
        "ground_clearance": (0.34, 0.42),
        "nose_height": (1.08, 1.2),
        "cowl_height": (1.35, 1.48),
        "bonnet_length": (0.045, 0.075),
        "windscreen_rake": (0.25, 0.42),
        "rear_rake": (0.02, 0.06),
        "deck_length": (0.02, 0.03),
        "deck_height": (1.2, 1.3),
        "belt_height": (1.28, 1.4),
        "roof_drop": (0.0, 0.02),
        "tail_width": (0.3, 0.4),
        "tail_height": (0.12, 0.16),
        "lamp_height": (0.16, 0.24),
        "lamp_width": (0.3, 0.4),
        "lamp_slant": (-0.02, 0.1),
        "tumblehome": (0.05, 0.09),
        "wedge": (0.0, 0.002),
        "shoulder": (0.0, 0.01),
        "corner": (0.12, 0.2),
        "bow": (0.08, 0.14),
        "roof_arch": (0.02, 0.04),
        "rim_share": (0.5, 0.56),
        "tyre_width": (0.24, 0.28),
        "cab_height": (2.2, 2.5),
        "box_length": (0.66, 0.72),
        "grille_width": (0.8, 1.2),
        "flare": (0.0, 0.01),
    },
    "bus": _CAR
    | {
        "length": (10.5, 12.4),
        "width": (2.5, 2.55),
        "height": (2.95, 3.25),
        "wheelbase": (0.48, 0.52),
        "front_overhang": (0.21, 0.235),
        "wheel_radius": (0.46, 0.5),
        "ground_clearance": (0.28, 0.34),
        "nose_height": (0.9, 1.05),
        "cowl_height": (1.1, 1.25),
        "bonnet_length": (0.0, 0.002),
        "windscreen_rake": (0.03, 0.1),
        "rear_rake": (0.02, 0.06),
        "deck_length": (0.02, 0.03),
        "deck_height": (1.2, 1.4),
        "belt_height": (1.05, 1.3),
        "roof_drop": (0.0, 0.03),
        "tail_width": (0.14, 0.2),
        "tail_height": (0.35, 0.6),
        "lamp_height": (0.17, 0.26),
        "lamp_width": (0.34, 0.5),
        "lamp_slant": (-0.05, 0.2),
        "tumblehome": (0.01, 0.035),
        "wedge": (0.0, 0.001),
        "shoulder": (0.0, 0.005),
        "corner": (0.12, 0.2),
        "bow": (0.05, 0.16),
        "roof_arch": (0.02, 0.05),
        "rim_share": (0.52, 0.58),
        "tyre_width": (0.27, 0.3),
        "grille_width": (0.6, 1.4),
        "flare": (0.0, 0.005),
        "crease": (0.0, 0.004),
    },
}
"""Least and greatest values. These are shares of the length: wheelbase, front_overhang,
bonnet_length and (box trucks) box_length."""

_SHARES_OF_LENGTH = ("wheelbase", "front_overhang", "bonnet_length", "box_length")

# Sizes that grow together: a long car of a kind is also wide.
_GROW = ("length", "width", "wheel_radius", "nose_height", "cowl_height", "belt_height")

_SIDE_WINDOWS = {
    "hatchback": (1, 2),
    "sedan": (1, 2),
    "estate": (2, 2),
    "suv": (2, 2),
    "pickup": (1, 1),
    "van": (0, 2),
    "box-truck": (0, 0),
    "bus": (5, 7),
}


def sample_kind(rng: np.random.Generator) -> str:
    """A kind of vehicle, as often as it is met on the road."""
    return KINDS[int(rng.choice(len(KINDS), p=[KIND_SHARES[kind] for kind in KINDS]))]


def sample_parameters(kind: str, rng: np.random.Generator) -> VehicleParameters:
    """A random vehicle of a kind; every size within what is usual for it.

    Raises:
        InputError: no such kind.
    """
    if kind not in KINDS:
        raise InputError("vehicle", "kind", f"{kind!r} is unknown", f"use {', '.join(KINDS)}")
    size = rng.random()
    values: dict[str, float] = {}
    for name, (low, high) in _RANGES[kind].items():
        draw = rng.random()
        share = 0.6 * size + 0.4 * draw if name in _GROW else draw
        values[name] = low + share * (high - low)
    for name in _SHARES_OF_LENGTH:
        if name in values:
            values[name] *= values["length"]
    low_windows, high_windows = _SIDE_WINDOWS[kind]
    rugged = kind in ("suv", "pickup")
    cladding = float(rng.uniform(0.03, 0.07)) if rugged and rng.random() < 0.6 else 0.0
    if kind == "van":
        # A high roof goes with a long van.
        values["height"] = 1.93 + 0.62 * size + 0.05 * rng.random()
        # Most vans carry goods and have no windows behind the doors.
        low_windows, high_windows = (0, 0) if rng.random() < 0.6 else (1, 2)
    flags = rng.random(2)
    return VehicleParameters(
        kind=kind,
        grille_bars=int(rng.integers(0, 5)),
        side_windows=int(rng.integers(low_windows, high_windows + 1)),
        spokes=int(rng.integers(5, 11)),
        cladding=min(cladding, LIMITS["cladding"][1]),
        roof_rails=bool(flags[0] < {"estate": 0.75, "suv": 0.7}.get(kind, 0.0)),
        chrome=bool(flags[1] < 0.4),
        shade=float(rng.uniform(-1, 1)),
        **values,
    )


class PaintColour(NamedTuple):
    """A paint.

    Attributes:
        rgb: linear reflectance.
        share: of all passenger cars on the road; the shares add up to 1.
    """

    rgb: tuple[float, float, float]
    share: float


COLOURS: dict[str, PaintColour] = {
    "white": PaintColour((0.78, 0.78, 0.76), 0.35),
    "black": PaintColour((0.012, 0.012, 0.014), 0.22),
    "grey": PaintColour((0.12, 0.125, 0.13), 0.18),
    "silver": PaintColour((0.42, 0.43, 0.44), 0.10),
    "blue": PaintColour((0.025, 0.075, 0.26), 0.07),
    "red": PaintColour((0.38, 0.018, 0.02), 0.04),
    "green": PaintColour((0.03, 0.11, 0.06), 0.012),
    "beige": PaintColour((0.48, 0.40, 0.28), 0.01),
    "brown": PaintColour((0.10, 0.055, 0.03), 0.008),
    "orange": PaintColour((0.62, 0.16, 0.015), 0.006),
    "yellow": PaintColour((0.75, 0.48, 0.03), 0.004),
}
"""By name. Shares are rounded from industry surveys of car paint (white, black, grey and silver
make up about five cars in six)."""

_KIND_SHARES: dict[str, dict[str, float]] = {
    "van": {"white": 0.66, "grey": 0.10, "silver": 0.09, "black": 0.07, "blue": 0.05, "red": 0.03},
    "box-truck": {"white": 0.76, "blue": 0.08, "red": 0.06, "grey": 0.05, "yellow": 0.05},
    "bus": {
        "red": 0.24,
        "white": 0.22,
        "blue": 0.18,
        "yellow": 0.16,
        "green": 0.12,
        "orange": 0.08,
    },
}


def colour_shares(kind: str) -> dict[str, float]:
    """How often each colour is met among vehicles of a kind; adds up to 1."""
    return _KIND_SHARES.get(kind, {name: colour.share for name, colour in COLOURS.items()})


def sample_colour(kind: str, rng: np.random.Generator) -> str:
    """The name of a colour, as often as it is met on the road for that kind."""
    shares = colour_shares(kind)
    weights = np.fromiter(shares.values(), np.float64)
    return list(shares)[int(rng.choice(len(weights), p=weights / weights.sum()))]


def paint_rgb(colour: str, shade: float) -> tuple[float, float, float]:
    """Linear RGB of a named colour, darker or lighter by `shade` in [-1, 1].

    Raises:
        InputError: no such colour.
    """
    if colour not in COLOURS:
        raise InputError("vehicle", "colour", f"{colour!r} is unknown", f"use {', '.join(COLOURS)}")
    factor = 1.0 + (0.12 if colour == "white" else 0.35) * shade
    red, green, blue = (min(channel * factor, 0.85) for channel in COLOURS[colour].rgb)
    return (red, green, blue)


def vehicle_parts(parameters: VehicleParameters, colour: str) -> Parts:
    """Name and surface of every part, each closed, in the actor-local frame.

    Raises:
        InputError: an impossible size, or an unknown colour.
    """
    parameters.validate()
    paint = Finish(paint_rgb(colour, parameters.shade), "paint")
    maker = {"bus": bus, "box-truck": box_truck}.get(parameters.kind, car)
    parts = maker(parameters, paint)
    counted = [part.bounds() for name, part in parts if not name.startswith("mirror")]
    low = np.min([bounds[0] for bounds in counted], axis=0)
    high = np.max([bounds[1] for bounds in counted], axis=0)
    size = np.array([parameters.length, parameters.width, parameters.height])
    # Handles, rails and bowed skins differ from the stated size by millimetres; the box is exact.
    scale, middle = size / (high - low), (low + high) / 2
    return [(name, _fitted(part, middle, scale)) for name, part in parts]


def build_vehicle(parameters: VehicleParameters, colour: str) -> VehicleModel:
    """The finished vehicle; its size is the bounds of all parts but the mirrors.

    Args:
        parameters: sizes.
        colour: a name in `COLOURS`.

    Raises:
        InputError: an impossible size, or an unknown colour.
    """
    parts = vehicle_parts(parameters, colour)
    return VehicleModel(
        kind=parameters.kind,
        category=CATEGORIES.get(parameters.kind, "car"),
        colour=colour,
        size=np.array([parameters.length, parameters.width, parameters.height]),
        surface=concatenate([part for _, part in parts]),
    )


def sample_vehicle(rng: np.random.Generator, kind: str | None = None) -> VehicleModel:
    """A random vehicle: kind (unless given), sizes and colour as on the road.

    Raises:
        InputError: no such kind.
    """
    kind = sample_kind(rng) if kind is None else kind
    parameters = sample_parameters(kind, rng)
    return build_vehicle(parameters, sample_colour(kind, rng))


def _fitted(part: Surface, middle: np.ndarray, scale: np.ndarray) -> Surface:
    normals = part.normals / scale
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return Surface(
        (part.vertices - middle) * scale,
        part.faces,
        normals.astype(np.float32),
        part.colours,
        part.materials,
    )
