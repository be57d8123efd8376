"""What is fitted to a body: windows and their pillars, wheels, mirrors, handles, rails, beams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from recast.arrays import Array
from recast.synthetic.scenery.primitives import at
from recast.synthetic.surface import Surface, corner_normals, sheet, spindle
from recast.synthetic.vehicles.loft import LoftedBody, half_box
from recast.synthetic.vehicles.parameters import VehicleSizes
from recast.synthetic.vehicles.solid import (
    ALLOY,
    CHROME,
    DARK_GLASS,
    GLASS,
    STEEL,
    TRIM,
    TYRE,
    Area,
    Finish,
    Solid,
    rounded,
    strip,
)


def pebble(
    centre: tuple[float, float, float],
    size: tuple[float, float, float],
    finish: Finish,
    roundness: float = 2.5,
    cells: tuple[int, int] = (8, 12),
) -> Solid:
    """A closed superellipsoid: 2 is an ellipsoid, large values a box with rounded edges.

    Args:
        centre, size: metres.
        roundness: the exponent.
        cells: numbers of cells from pole to pole (upwards) and around.
    """
    rows, columns = cells
    polar = np.linspace(np.pi, 0, rows + 1)[1:-1, None]
    around = (np.arange(columns) + 0.5) * 2 * np.pi / columns
    parts = (np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar))
    rings = np.stack(np.broadcast_arrays(*parts), axis=-1)
    ball, faces = spindle(rings, [[0, 0, -1], [0, 0, 1]])
    norm = (np.abs(ball) ** roundness).sum(axis=1) ** (1 / roundness)
    points = np.array(centre) + ball / norm[:, None] * np.array(size) / 2
    return Solid.of(points, faces, finish, crease=np.deg2rad(50))


def grid_block(xs: Array, ys: Array, zs: Array, finish: Finish) -> Solid:
    """A closed box whose sides are divided at the given coordinates (increasing)."""
    points, faces = half_box((xs, ys - ys[0], zs))
    points[:, 1] += ys[0]
    # `half_box` leaves the side at the first y open.
    at = {tuple(point): k for k, point in enumerate(np.round(points, 9).tolist())}
    index = np.array([[at[tuple(np.round((x, ys[0], z), 9))] for z in zs] for x in xs])
    return Solid.of(points, np.concatenate([faces, sheet(index.T)]), finish)


def block(
    low: tuple[float, float, float], high: tuple[float, float, float], finish: Finish
) -> Solid:
    """A closed box between two corners."""
    xs, ys, zs = (np.array([low[k], high[k]]) for k in range(3))
    return grid_block(xs, ys, zs, finish)


def mirror(x: float, y: float, z: float, paint: Finish, tall: bool = False) -> list[Solid]:
    """The left mirror, its foot at (x, y, z) on the door."""
    size = (0.16, 0.18, 0.34) if tall else (0.14, 0.21, 0.15)
    centre = (x - 0.02, y + size[1] / 2 + 0.045, z + (0.08 if tall else 0.05))
    shell = pebble(centre, size, TRIM if tall else paint, 3.0, (8, 12))
    rear = centre[0] - 0.36 * size[0]
    shell.paint(lambda s: s.x - rear, TRIM)
    glass = np.array(size) * 0.42

    def pane(s: Solid) -> Array:
        off = np.abs(s.points - np.array(centre)) / glass
        return np.maximum(s.x - rear + 0.012, (np.maximum(off[:, 1], off[:, 2]) - 1) / 9)

    shell.paint(pane, CHROME)
    foot = pebble((x, y + 0.03, z), (0.07, 0.14, 0.05), TRIM, 3.0, (4, 6))
    return [shell, foot]


def handle(x: float, y: float, z: float, finish: Finish) -> Solid:
    """A door handle on the left side."""
    return pebble((x, y + 0.006, z), (0.19, 0.04, 0.03), finish, 4.0, (4, 8))


def rail(start: tuple[float, float, float], end: tuple[float, float, float]) -> list[Solid]:
    """A roof rail on two feet, left side."""
    a, b = np.array(start), np.array(end)
    middle, span = (a + b) / 2, float(np.linalg.norm(b - a))
    bar = pebble((0, 0, 0), (span, 0.035, 0.03), TRIM, 5.0, (4, 10))
    pitch = np.arctan2(b[2] - a[2], b[0] - a[0])
    cos, sin = np.cos(pitch), np.sin(pitch)
    bar.points = bar.points @ np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]]) + middle
    return [
        bar,
        *(
            pebble((p[0], p[1], p[2] - 0.025), (0.12, 0.04, 0.07), TRIM, 4.0, (4, 8))
            for p in (a * 0.94 + b * 0.06, b * 0.94 + a * 0.06)
        ),
    ]


def both(side: Parts) -> Parts:
    """Parts of the left side, by name, and their mirror images."""
    return [(f"{name}-left", part) for name, part in side] + [
        (f"{name}-right", part.scaled((1, -1, 1))) for name, part in side
    ]


def wheel(
    radius: float, width: float, rim_share: float, spokes: int, dished: bool = False
) -> Surface:
    """One closed wheel about the origin that turns about y and shows its rim at +y.

    Args:
        radius: radius of the tyre, metres.
        width: width of the tyre.
        rim_share: rim radius over tyre radius.
        spokes: number of spokes of the rim.
        dished: a steel rim with holes, as heavy vehicles have.
    """
    per_spoke = 6 if spokes == 5 else 4
    count = spokes * per_spoke
    angle = np.arange(count) * 2 * np.pi / count
    rim, half = radius * rim_share, width / 2
    # Rings from the hub outwards, over the tread and back to the axle: (radius, y).
    rings: list[tuple[float, float]] = [
        (0.2 * rim, half - 0.035),
        (0.34 * rim, half - 0.04),
        (0.62 * rim, half - 0.03),
        (0.88 * rim, half - 0.02),
        (0.97 * rim, half - 0.012),
        (1.03 * rim, half - 0.004),
        (0.5 * (rim + radius), half + 0.002),
        (0.96 * radius, half - 0.01),
        (radius, 0.5 * half),
        (radius, -0.5 * half),
        (0.96 * radius, -half),
        (0.6 * rim, -half),
    ]
    r = np.array([ring[0] for ring in rings])
    y = np.tile(np.array([ring[1] for ring in rings])[:, None], (1, count))
    phase = (np.arange(count) % per_spoke) / per_spoke
    gap = phase >= 0.5
    gap_columns = gap & np.roll(gap, 1) if per_spoke > 4 else gap
    # The holes lie between ring 1 and ring 3; dished rims bulge inwards instead.
    deep = 0.07 if not dished else 0.035
    for ring in (1, 2, 3):
        y[ring] -= np.where(gap_columns, deep, 0.0)
    if dished:
        y[:2] += 0.05 - half * 0.3
        y[2:4] -= half * 0.35
    x, z = r[:, None] * np.cos(angle), r[:, None] * np.sin(angle)
    ends = np.array([[0, y[0, 0] + 0.008, 0], [0, y[-1, 0], 0]])
    points, faces = spindle(np.stack([x, y, z], axis=-1), ends)
    ring_of = np.repeat([*np.tile(np.arange(len(rings) - 1), 2), -1, len(rings)], count)
    solid = Solid.of(points, faces, TYRE)
    bright = STEEL if dished else ALLOY
    solid.paint_faces((ring_of >= -1) & (ring_of <= 4), bright)
    low = y.ravel()[np.minimum(faces, y.size - 1)].min(axis=1)
    in_disc = (ring_of >= 0) & (ring_of <= 3)
    face_y = np.array([ring[1] for ring in rings])[np.clip(ring_of, 0, len(rings) - 1)]
    solid.paint_faces(in_disc & (low < face_y - deep * 0.8 - (half if dished else 0)), STEEL)
    if not dished:
        pressed = in_disc & (low < face_y - 0.045)
        solid.paint_faces(pressed, Finish((0.02, 0.02, 0.02), "matte"))
    solid.normals = corner_normals(points, faces.astype(np.int32), np.deg2rad(40)).astype(float)
    return solid.surface()


def steel_wheels(p: VehicleSizes) -> Parts:
    """Wheels of a heavy vehicle; the rear ones are twins."""
    turned = wheel(p.wheel_radius, p.tyre_width, p.rim_share, 8, dished=True)
    edge = p.width / 2 - p.tyre_width / 2 - 0.04
    inset = 0.04 * p.width if p.kind == "box-truck" else 0.0
    front, rear = p.axles
    places = [("0", front, edge - inset), ("1", rear, edge)]
    places.append(("1-inner", rear, edge - (p.tyre_width + 0.03)))
    return both([(f"wheel-{name}", at(turned, x, y, p.wheel_radius)) for name, x, y in places])


Parts = list[tuple[str, Surface]]
"""Closed surfaces by name."""


@dataclass(frozen=True)
class SideGlass:
    """The outline of the side windows in the side view.

    Attributes:
        rear: x at the belt line where the glass ends.
        rear_lean: metres that the rear end moves forward per metre of height.
        pillar: width of the windscreen pillar and the roof rail above the glass.
        sill: height of the lower edge over the belt line.
        tall: greatest height of the glass over the belt line.
    """

    rear: float
    rear_lean: float
    pillar: float = 0.1
    sill: float = 0.015
    tall: float = 2.0

    def field(self, body: LoftedBody, solid: Solid) -> Array:
        """Negative inside."""
        slope = body.top.slope(body.length / 2 - solid.station)
        over = (solid.z - body.outline(solid.station)) / np.sqrt(1 + slope**2) + self.pillar
        rise = solid.z - body.belt_at(solid.x)
        fields = [self.sill - rise, over, rise - self.tall]
        fields.append((self.rear + self.rear_lean * rise) - solid.x)
        return rounded(fields, 0.06, 0.8 - solid.across)


def side_windows(
    solid: Solid, body: LoftedBody, glass: SideGlass, pillars: Sequence[float], chrome: bool
) -> None:
    """Glass with a trim around it, divided at the pillars' x."""
    solid.paint(lambda s: glass.field(body, s) - 0.018, CHROME if chrome else TRIM)
    solid.paint(lambda s: glass.field(body, s), GLASS)
    for k, pillar in enumerate(pillars):
        half = 0.045 if k == 0 else 0.032

        def post(s: Solid, x: float = pillar, half: float = half) -> Area:
            lean = 0.08 * (s.z - body.belt_at(s.x))
            return strip(s.x - x + lean, half), [glass.field(body, s)]

        solid.paint(post, TRIM, over=("glass",))


def screen(
    solid: Solid, body: LoftedBody, low_x: float, high_x: float, inset: float, low_z: float = 0.0
) -> None:
    """A window in the upper skin, such as the windscreen, in a black band of ceramic ink.

    Args:
        solid, body: half of the body; its shape.
        low_x, high_x: x at which the glass begins and ends, in the middle plane.
        inset: metres from the glass to the upper edge of the side.
        low_z: height that the glass stays above.
    """

    def field(s: Solid) -> Array:
        slope = np.sqrt(1 + body.top.slope(body.length / 2 - s.station) ** 2)
        sides = (s.across - 1) * body.half_width(s.x, s.z) + inset
        fields = [(low_x - s.station) * slope, (s.station - high_x) * slope, sides, low_z - s.z]
        return rounded(fields, 0.07, 0.8 - s.up)

    solid.paint(field, TRIM)
    solid.paint(lambda s: field(s) + 0.035, GLASS)


def face_window(
    solid: Solid, sign: float, x_limit: float, half: float, low: float, high: float
) -> None:
    """Glass in an upright end of the body: front (sign 1) or rear (-1)."""

    def field(s: Solid) -> Array:
        return rounded([s.y - half, low - s.z, s.z - high], 0.08, sign * (x_limit - s.x))

    solid.paint(lambda s: field(s) - 0.03, TRIM)
    solid.paint(field, DARK_GLASS if sign < 0 else GLASS)
