"""Where a car's windows, doors and bed are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.vehicles.finishes import (
    CLADDING,
    GLASS,
    SEAM,
    TRIM,
    Area,
    smooth_max,
    strip,
    xyz,
)
from recast.synthetic.vehicles.glazing import SideGlass, screen
from recast.synthetic.vehicles.loft import Body
from recast.synthetic.vehicles.parameters import VehicleParameters
from recast.synthetic.vehicles.solid import Solid

Array = NDArray[np.float64]


def side_layout(
    p: VehicleParameters, body: Body, gutter: float
) -> tuple[SideGlass, list[float], list[float]]:
    """Outline of the side glass, x of the pillars, x of the door edges."""
    front, rear = p.axles
    first = front - p.wheel_radius - 0.16
    if p.kind == "van":
        middle = first - 1.05
        if p.side_windows == 0:
            return SideGlass(middle + 0.03, 0.02, 0.13, tall=0.72), [], [first, middle]
        glass = SideGlass(-p.length / 2 + 0.25, 0.03, 0.13, tall=0.72)
        posts = [middle, middle - 0.5 * (middle + p.length / 2)]
        return glass, posts[: p.side_windows], [first, middle, middle - 1.1]
    if p.kind == "pickup":
        middle = first - 0.98
        glass = SideGlass(gutter + 0.12, -0.05, 0.1)
        return glass, [middle], [first, middle, gutter + 0.06]
    share = {"hatchback": 0.52, "sedan": 0.49, "estate": 0.47, "suv": 0.48}[p.kind]
    middle = first - share * (first - rear) - 0.14
    third = rear + 0.12
    if p.kind == "sedan":
        # The rear pillar stands wide: the glass ends above the rear axle.
        glass = SideGlass(rear - 0.12, 0.55, 0.085)
        return glass, [middle] if p.side_windows == 1 else [middle, third], [first, middle, third]
    end = {"hatchback": rear - 0.12, "estate": rear - 0.62, "suv": rear - 0.42}[p.kind]
    end = max(end, -p.length / 2 + 0.3)
    glass = SideGlass(end, 0.45 if p.kind == "hatchback" else 0.7, 0.085)
    posts = [middle] if p.side_windows == 1 else [middle, third]
    return glass, posts, [first, middle, third]


def rear_window(solid: Solid, body: Body, p: VehicleParameters, deck: float, gutter: float) -> None:
    """Glass in the rear, of the form that the kind has."""
    if p.kind == "van":
        _van_rear(solid, p)
        return
    if p.kind == "pickup":
        _cab_back(solid, p, deck, gutter)
        return
    run = gutter - deck
    upper, lower = gutter - 0.04 * run - 0.02, deck + 0.1 * run
    if p.kind == "sedan":
        lower = deck + 0.06
    screen(solid, body, lower, upper, 0.1, low_z=p.deck_height + 0.05)


def _cab_back(solid: Solid, p: VehicleParameters, deck: float, gutter: float) -> None:
    def pane(s: Solid) -> Array:
        x, y, z = xyz(s)
        fields = [y - 0.34 * p.width, p.deck_height + 0.1 - z, z - p.height + 0.19]
        limits = [x - gutter - 0.15, deck - 0.2 - x, 0.75 - s.coords[:, 2]]
        return np.maximum(smooth_max(fields, 0.06), np.maximum.reduce(limits))

    solid.paint(pane, TRIM)
    solid.paint(lambda s: pane(s) + 0.03, GLASS)


def _van_rear(solid: Solid, p: VehicleParameters) -> None:
    """Two doors behind, glazed where the sides are."""
    rear = -p.length / 2
    low, high = p.belt_height + 0.05, p.height - 0.25

    def joint(s: Solid) -> Area:
        return strip(s.points[:, 1], 0.005), [s.points[:, 0] - rear - 0.3]

    def pane(s: Solid) -> Array:
        x, y, z = xyz(s)
        fields = [0.07 - y, y - 0.38 * p.width, low - z, z - min(high, low + 0.65)]
        return np.maximum(smooth_max(fields, 0.07), x - rear - 0.4)

    solid.paint(joint, SEAM)
    if p.side_windows:
        solid.paint(lambda s: pane(s) - 0.02, TRIM)
        solid.paint(pane, GLASS)


def open_bed(solid: Solid, p: VehicleParameters, front: float, rear: float) -> None:
    """Hollow out the bed of a pickup between two x."""
    # Above the wheel wells.
    floor = p.wheel_radius * 2.12 + 0.06

    def area(s: Solid) -> Array:
        x, y, _ = xyz(s)
        fields = [x - front + 0.06, rear + 0.17 - x, y - p.width / 2 + 0.13]
        return np.maximum(smooth_max(fields, 0.04), 0.8 - s.coords[:, 2])

    def down(points: Array) -> Array:
        moved = points.copy()
        moved[:, 2] = floor
        return moved

    solid.paint(lambda s: area(s) - 0.06, TRIM)
    solid.push(area, down, CLADDING)
