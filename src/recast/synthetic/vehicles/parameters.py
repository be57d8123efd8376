"""The numbers that make a vehicle: what they mean, what is possible, and what is usual."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple, get_type_hints

import numpy as np

from recast.core.errors import InputError

KINDS = ("hatchback", "sedan", "estate", "suv", "pickup", "van", "box-truck", "bus")
"""All kinds of vehicles."""


@dataclass(frozen=True)
class VehicleSizes:
    """Sizes in metres, angles in radians; heights above the ground.

    Attributes:
        kind: one of `KINDS`.
        length, width, height: size of the box; mirrors not counted.
        wheelbase: distance between the axles.
        front_overhang: distance from the bumper to the front axle.
        wheel_radius, tyre_width: radius and width of the tyres.
        ground_clearance: distance from the ground to the sill.
        nose_height: height of the bonnet's leading edge.
        cowl_height: height of the windscreen's foot.
        bonnet_length: distance from the bumper to the windscreen's foot.
        windscreen_rake: angle of the windscreen, from upright.
        rear_rake: angle of the rear window, from upright.
        deck_length: length of the boot lid (or the bed) behind the rear window.
        deck_height: height of the boot lid, or of the rear window's foot.
        belt_height: height of the side windows' lower edge at the front axle.
        wedge: rise of that edge per metre towards the rear.
        tumblehome: lean of the side windows, from upright.
        shoulder: width of the ledge beneath the side windows.
        roof_arch: rise of the roof over its front edge.
        roof_drop: fall of the roof to its rear edge.
        bow: how far the front's middle stands before its corners.
        corner: radius of the corners in plan.
        flare: how far the lips of the wheel arches stand out.
        crease: depth of the line along the side.
        lamp_width, lamp_height: size of the headlamps.
        lamp_slant: slant of the headlamps: rise per metre outwards.
        tail_width, tail_height: size of the tail lamps.
        grille_width, grille_height: size of the upper grille.
        intake_height: height of the lower grille.
        grille_bars: number of chrome bars in the grille.
        side_windows: number of panes behind the first door, on each side.
        spokes: number of spokes of each rim.
        rim_share: rim radius over wheel radius.
        cladding: width of unpainted plastic around the arches; 0 for none.
        roof_rails: rails on the roof.
        chrome: bright trim around windows and grille.
        shade: -1 (dark) to 1 (light) within the paint's name.
        box_length: length of the load box (box trucks).
        cab_height: height of the cab (box trucks).
    """

    kind: str
    length: Annotated[float, (2.2, 20.0)]
    width: Annotated[float, (1.2, 2.7)]
    height: Annotated[float, (1.1, 4.4)]
    wheelbase: float
    front_overhang: float
    wheel_radius: Annotated[float, (0.2, 0.65)]
    tyre_width: float
    ground_clearance: float
    nose_height: float
    cowl_height: float
    bonnet_length: Annotated[float, (0.0, 2.5)]
    windscreen_rake: Annotated[float, (0.0, 1.25)]
    rear_rake: Annotated[float, (0.0, 1.3)]
    deck_length: float
    deck_height: float
    belt_height: float
    wedge: Annotated[float, (-0.05, 0.1)]
    tumblehome: Annotated[float, (0.0, 0.6)]
    shoulder: Annotated[float, (0.0, 0.12)]
    roof_arch: Annotated[float, (0.0, 0.15)]
    roof_drop: Annotated[float, (0.0, 0.4)]
    bow: Annotated[float, (0.0, 0.4)]
    corner: Annotated[float, (0.03, 0.5)]
    flare: Annotated[float, (0.0, 0.08)]
    crease: Annotated[float, (0.0, 0.04)]
    lamp_width: Annotated[float, (0.08, 0.8)]
    lamp_height: Annotated[float, (0.05, 0.5)]
    lamp_slant: Annotated[float, (-0.5, 0.5)]
    tail_width: Annotated[float, (0.05, 0.8)]
    tail_height: Annotated[float, (0.05, 0.9)]
    grille_width: Annotated[float, (0.1, 2.2)]
    grille_height: Annotated[float, (0.02, 0.6)]
    intake_height: Annotated[float, (0.02, 0.4)]
    grille_bars: Annotated[int, (0, 6)]
    side_windows: Annotated[int, (0, 10)]
    spokes: Annotated[int, (4, 16)]
    rim_share: Annotated[float, (0.4, 0.85)]
    cladding: Annotated[float, (0.0, 0.12)] = 0.0
    roof_rails: bool = False
    chrome: bool = False
    shade: Annotated[float, (-1.0, 1.0)] = 0.0
    box_length: float = 0.0
    cab_height: float = 0.0

    @property
    def axles(self) -> tuple[float, float]:
        """x of the front and the rear axle, from the middle of the vehicle."""
        front = self.length / 2 - self.front_overhang
        return front, front - self.wheelbase

    @property
    def body_height(self) -> float:
        """Height of the part with windscreen and doors."""
        return self.cab_height if self.kind == "box-truck" else self.height

    def validate(self) -> None:
        """Raise InputError that names the first impossible field."""
        if self.kind not in KINDS:
            raise _bad("kind", f"{self.kind!r} is unknown", f"use one of {', '.join(KINDS)}")
        for name, (low, high) in LIMITS.items():
            value = getattr(self, name)
            if not (np.isfinite(value) and low <= value <= high):
                raise _bad(name, f"{value:g} is impossible", f"use {low:g} to {high:g}")
        for name, low, high, why in self._relations():
            value = getattr(self, name)
            if not low <= value <= high:
                raise _bad(name, f"{value:.4g} does not fit {why}", f"use {low:.4g} to {high:.4g}")

    def _relations(self) -> list[tuple[str, float, float, str]]:
        radius = self.wheel_radius
        top = self.body_height
        run = (top - self.cowl_height) * np.tan(self.windscreen_rake)
        room = self.length - self.bonnet_length - run
        rear = (top - self.deck_height) * np.tan(self.rear_rake)
        rules = [
            ("width", 0.2 * self.length if self.length < 6 else 1.8, 0.62 * self.length, "length"),
            ("front_overhang", radius + 0.1, 0.4 * self.length, "wheel_radius and length"),
            (
                "wheelbase",
                2.5 * radius + 0.3,
                self.length - self.front_overhang - radius - 0.1,
                "length, front_overhang and wheel_radius",
            ),
            ("ground_clearance", 0.08, 1.3 * radius, "wheel_radius"),
            ("tyre_width", 0.1, 0.25 * self.width, "width"),
            ("nose_height", self.ground_clearance + 0.3, top, "ground_clearance and height"),
            ("cowl_height", self.nose_height, top - 0.3, "nose_height and height"),
            ("deck_height", self.ground_clearance + 0.4, top, "height"),
            ("belt_height", self.ground_clearance + 0.35, top - 0.25, "height"),
            ("deck_length", 0.0, max(room - rear - 0.3, 0.0), "length, bonnet and windscreen"),
        ]
        if self.kind == "box-truck":
            rules[-1] = ("box_length", 1.5, self.length - 1.4, "length")
            rules.append(("cab_height", 1.6, self.height, "height"))
        return rules


LIMITS: dict[str, tuple[float, float]] = {
    name: hint.__metadata__[0]
    for name, hint in get_type_hints(VehicleSizes, include_extras=True).items()
    if hasattr(hint, "__metadata__")
}
"""Field -> least and greatest possible value, whatever the rest."""

_USUAL = """
kind             hatchback sedan     estate    suv       pickup    van       box-truck bus
tyre_width       .2:.24    .2:.24    .2:.24    .22:.26   .24:.29   .2:.24    .24:.28   .27:.3
wedge            .01:.035  .01:.035  .01:.035  .01:.035  0:.01     0:.005    0:.002    0:.001
shoulder         .01:.035  .01:.035  .01:.035  .01:.035  .01:.035  0:.015    0:.01     0:.005
roof_arch        .03:.06   .03:.06   .03:.06   .03:.06   .03:.06   .02:.05   .02:.04   .02:.05
bow              .1:.2     .1:.2     .1:.2     .1:.2     .1:.2     .12:.22   .08:.14   .05:.16
corner           .2:.3     .2:.3     .2:.3     .2:.3     .14:.22   .12:.2    .12:.2    .12:.2
flare            .008:.022 .008:.022 .008:.022 .015:.035 .02:.045  .008:.022 0:.01     0:.005
crease           0:.022    0:.022    0:.022    0:.022    0:.022    0:.022    0:.022    0:.004
tumblehome       .3:.4     .3:.4     .3:.4     .24:.34   .2:.28    .06:.14   .05:.09   .01:.035
lamp_width       .36:.52   .36:.52   .36:.52   .36:.52   .36:.52   .3:.42    .3:.4     .34:.5
lamp_height      .11:.19   .11:.19   .11:.19   .11:.19   .11:.19   .18:.27   .16:.24   .17:.26
lamp_slant       .02:.22   .02:.22   .02:.22   .02:.22   .02:.22   .02:.22   -.02:.1   -.05:.2
grille_width     .5:1      .5:1      .5:1      .5:1      .5:1      .5:1      .8:1.2    .6:1.4
grille_height    .07:.24   .07:.24   .07:.24   .14:.3    .22:.36   .07:.24   .07:.24   .07:.24
intake_height    .1:.2     .1:.2     .1:.2     .1:.2     .1:.2     .1:.2     .1:.2     .1:.2
rim_share        .62:.72   .62:.72   .62:.72   .62:.72   .62:.72   .56:.62   .5:.56    .52:.58
length           3.75:4.4  4.5:5     4.45:4.95 4.35:4.95 5.15:5.65 4.7:6     6.2:7.8   10.5:12.4
width            1.68:1.82 1.78:1.9  1.78:1.88 1.82:1.98 1.84:2.02 1.88:2.05 2.15:2.45 2.5:2.55
height           1.44:1.54 1.42:1.49 1.44:1.52 1.62:1.8  1.76:1.92 1.92:2.6  2.9:3.4   2.95:3.25
wheelbase        .595:.625 .58:.605  .575:.6   .575:.605 .59:.615  .59:.625  .53:.58   .48:.52
front_overhang   .185:.205 .18:.2    .185:.2   .18:.195  .165:.18  .165:.185 .13:.16   .21:.235
wheel_radius     .3:.33    .315:.35  .315:.345 .345:.39  .37:.41   .33:.36   .38:.44   .46:.5
ground_clearance .15:.19   .14:.17   .14:.18   .2:.26    .26:.34   .18:.24   .34:.42   .28:.34
nose_height      .72:.8    .68:.76   .69:.77   .88:.99   1:1.1     .92:1.02  1.08:1.2  .9:1.05
cowl_height      .96:1.03  .93:.99   .94:1     1.08:1.16 1.16:1.24 1.2:1.3   1.35:1.48 1.1:1.25
bonnet_length    .215:.255 .245:.28  .23:.26   .225:.265 .225:.25  .115:.155 .045:.075 0:.002
windscreen_rake  .96:1.06  1.02:1.1  1:1.08    .86:1     .8:.95    .68:.85   .25:.42   .03:.1
rear_rake        .45:.75   1:1.13    .5:.8     .35:.65   .12:.3    .05:.12   .02:.06   .02:.06
deck_length      .06:.14   .46:.7    .07:.12   .05:.12   1.45:1.75 .02:.03   .02:.03   .02:.03
deck_height      .93:1.02  .98:1.07  .95:1     1.05:1.14 1.1:1.18  1.1:1.2   1.2:1.3   1.2:1.4
belt_height      .9:.97    .87:.93   .88:.94   1.03:1.12 1.1:1.17  1.13:1.22 1.28:1.4  1.05:1.3
roof_drop        .05:.12   .05:.1    .04:.08   .03:.09   .02:.05   .01:.04   0:.02     0:.03
tail_width       .2:.42    .36:.6    .3:.5     .24:.5    .14:.2    .12:.17   .3:.4     .14:.2
tail_height      .17:.32   .13:.2    .16:.26   .15:.32   .3:.45    .4:.7     .12:.16   .35:.6
cab_height       -         -         -         -         -         -         2.2:2.5   -
box_length       -         -         -         -         -         -         .66:.72   -
"""
"""Least and greatest usual value of each field, by kind. These are shares of the length: wheelbase,
front_overhang, bonnet_length and box_length. Values are drawn in this order."""

_SHARES_OF_LENGTH = ("wheelbase", "front_overhang", "bonnet_length", "box_length")

# Sizes that grow together: a long car of a kind is also wide.
_GROW = ("length", "width", "wheel_radius", "nose_height", "cowl_height", "belt_height")

KIND_SHARES: dict[str, float] = dict(
    zip(KINDS, (0.25, 0.24, 0.10, 0.24, 0.05, 0.08, 0.025, 0.015), strict=True)
)
"""Share of each kind on the road."""

_SIDE_WINDOWS = dict(
    zip(KINDS, ((1, 2), (1, 2), (2, 2), (2, 2), (1, 1), (0, 2), (0, 0), (5, 7)), strict=True)
)


def sample_kind(rng: np.random.Generator) -> str:
    """A kind of vehicle, as often as it is met on the road."""
    return KINDS[int(rng.choice(len(KINDS), p=[KIND_SHARES[kind] for kind in KINDS]))]


def sample_parameters(kind: str, rng: np.random.Generator) -> VehicleSizes:
    """A random vehicle of a kind; every size within what is usual for it.

    Raises:
        InputError: no such kind.
    """
    if kind not in KINDS:
        raise InputError("vehicle", "kind", f"{kind!r} is unknown", f"use {', '.join(KINDS)}")
    size = rng.random()
    values: dict[str, float] = {}
    for name, *usual in (line.split() for line in _USUAL.strip().splitlines()[1:]):
        cell = usual[KINDS.index(kind)]
        if cell == "-":
            continue
        low, high = map(float, cell.split(":"))
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
    return VehicleSizes(
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
    """A paint."""

    rgb: tuple[float, float, float]  # linear reflectance
    share: float  # share of all passenger cars on the road; the shares add up to 1


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
    """Linear RGB of a named colour, darker or lighter by `shade` in [-1, 1]. Raises InputError: no
    such colour."""
    if colour not in COLOURS:
        raise InputError("vehicle", "colour", f"{colour!r} is unknown", f"use {', '.join(COLOURS)}")
    factor = 1.0 + (0.12 if colour == "white" else 0.35) * shade
    red, green, blue = (min(channel * factor, 0.85) for channel in COLOURS[colour].rgb)
    return (red, green, blue)


def _bad(field: str, problem: str, mend: str) -> InputError:
    return InputError("vehicle", field, problem, mend)
