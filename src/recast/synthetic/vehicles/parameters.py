"""The numbers that make a vehicle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recast.core.errors import InputError

KINDS: tuple[str, ...] = (
    "hatchback",
    "sedan",
    "estate",
    "suv",
    "pickup",
    "van",
    "box-truck",
    "bus",
)
"""All kinds of vehicles."""


@dataclass(frozen=True)
class VehicleParameters:
    """Sizes in metres, angles in radians; heights above the ground.

    Attributes:
        kind: one of `KINDS`.
        length, width, height: of the box; mirrors not counted.
        wheelbase: between the axles.
        front_overhang: bumper to front axle.
        wheel_radius, tyre_width: of the tyres.
        ground_clearance: to the sill.
        nose_height: of the bonnet's leading edge.
        cowl_height: of the windscreen's foot.
        bonnet_length: bumper to the windscreen's foot.
        windscreen_rake: from upright.
        rear_rake: of the rear window, from upright.
        deck_length: of the boot lid (or the bed) behind the rear window.
        deck_height: of the boot lid, or of the rear window's foot.
        belt_height: of the side windows' lower edge at the front axle.
        wedge: rise of that edge per metre towards the rear.
        tumblehome: lean of the side windows, from upright.
        shoulder: width of the ledge beneath the side windows.
        roof_arch: rise of the roof over its front edge.
        roof_drop: fall of the roof to its rear edge.
        bow: how far the front's middle stands before its corners.
        corner: radius of the corners in plan.
        flare: of the wheel arches.
        crease: depth of the line along the side.
        lamp_width, lamp_height, lamp_slant: of the headlamps; slant is rise per metre outwards.
        tail_width, tail_height: of the tail lamps.
        grille_width, grille_height: of the upper grille.
        intake_height: of the lower grille.
        grille_bars: chrome bars in the grille.
        side_windows: panes behind the first door, on each side.
        spokes: of each rim.
        rim_share: rim radius over wheel radius.
        cladding: width of unpainted plastic around the arches; 0 for none.
        roof_rails: rails on the roof.
        chrome: bright trim around windows and grille.
        shade: -1 (dark) to 1 (light) within the paint's name.
        box_length: of the load box (box trucks).
        cab_height: of the cab (box trucks).
    """

    kind: str
    length: float
    width: float
    height: float
    wheelbase: float
    front_overhang: float
    wheel_radius: float
    tyre_width: float
    ground_clearance: float
    nose_height: float
    cowl_height: float
    bonnet_length: float
    windscreen_rake: float
    rear_rake: float
    deck_length: float
    deck_height: float
    belt_height: float
    wedge: float
    tumblehome: float
    shoulder: float
    roof_arch: float
    roof_drop: float
    bow: float
    corner: float
    flare: float
    crease: float
    lamp_width: float
    lamp_height: float
    lamp_slant: float
    tail_width: float
    tail_height: float
    grille_width: float
    grille_height: float
    intake_height: float
    grille_bars: int
    side_windows: int
    spokes: int
    rim_share: float
    cladding: float = 0.0
    roof_rails: bool = False
    chrome: bool = False
    shade: float = 0.0
    box_length: float = 0.0
    cab_height: float = 0.0

    @property
    def rear_overhang(self) -> float:
        """Rear axle to bumper."""
        return self.length - self.front_overhang - self.wheelbase

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
    "length": (2.2, 20.0),
    "width": (1.2, 2.7),
    "height": (1.1, 4.4),
    "wheel_radius": (0.2, 0.65),
    "bonnet_length": (0.0, 2.5),
    "windscreen_rake": (0.0, 1.25),
    "rear_rake": (0.0, 1.3),
    "wedge": (-0.05, 0.1),
    "tumblehome": (0.0, 0.6),
    "shoulder": (0.0, 0.12),
    "roof_arch": (0.0, 0.15),
    "roof_drop": (0.0, 0.4),
    "bow": (0.0, 0.4),
    "corner": (0.03, 0.5),
    "flare": (0.0, 0.08),
    "crease": (0.0, 0.04),
    "lamp_width": (0.08, 0.8),
    "lamp_height": (0.05, 0.5),
    "lamp_slant": (-0.5, 0.5),
    "tail_width": (0.05, 0.8),
    "tail_height": (0.05, 0.9),
    "grille_width": (0.1, 2.2),
    "grille_height": (0.02, 0.6),
    "intake_height": (0.02, 0.4),
    "grille_bars": (0, 6),
    "side_windows": (0, 10),
    "spokes": (4, 16),
    "rim_share": (0.4, 0.85),
    "cladding": (0.0, 0.12),
    "shade": (-1.0, 1.0),
}
"""Field -> least and greatest possible value, whatever the rest."""


def _bad(field: str, problem: str, mend: str) -> InputError:
    return InputError("vehicle", field, problem, mend)
