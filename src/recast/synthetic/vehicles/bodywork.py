"""What is fitted to a body: windows and their pillars, wheels, mirrors, handles, rails, beams."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from recast.arrays import Array
from recast.geometry.boxes import smooth_max
from recast.synthetic.surface import Surface, at, corner_normals, sheet, spindle
from recast.synthetic.vehicles.parameters import VehicleSizes
from recast.synthetic.vehicles.solid import (
    ALLOY,
    BEZEL,
    CHROME,
    DARK_GLASS,
    DAYLIGHT,
    DISPLAY,
    GLASS,
    INDICATOR,
    INK,
    LAMP,
    PLATE,
    PROJECTOR,
    REAR_PLATE,
    REVERSE,
    SEAM,
    STEEL,
    TAIL,
    TRIM,
    TYRE,
    Area,
    Finish,
    LoftedBody,
    Solid,
    half_box,
    rectangle,
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
    """The outline of the side windows in the side view."""

    rear: float  # x at the belt line where the glass ends
    rear_lean: float  # metres that the rear end moves forward per metre of height
    pillar: float = 0.1  # width of the windscreen pillar and the roof rail above the glass
    sill: float = 0.015  # height of the lower edge over the belt line
    tall: float = 2.0  # greatest height of the glass over the belt line

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


def disc(
    solid: Solid,
    y: float,
    z: float,
    sign: float,
    radius: float,
    finish: Finish,
    proud: float = 0.006,
) -> Surface:
    """A lens-like disc that stands out of the skin at (y, z) of an end of the body."""
    x = solid.reach(abs(y), z, sign)
    lens = pebble(
        (x + sign * (proud - 0.012), y, z), (0.024, 2 * radius, 2 * radius), finish, 2.4, (4, 10)
    )
    return lens.surface()


def badge(solid: Solid, z: float, sign: float, radius: float = 0.05) -> Surface:
    """The maker's sign in the middle."""
    return disc(solid, 0.0, z, sign, radius, CHROME, 0.004)


def number_plate(solid: Solid, low: float, sign: float, wide: float = 0.52) -> Surface:
    """A plate in the middle of an end, its lower edge at `low`, with seven characters."""
    high = low + 0.11
    edges = np.linspace(-0.43, 0.43, 7) * wide
    columns = np.concatenate(
        [[-wide / 2], np.sort(np.concatenate([edges - 0.016, edges + 0.016])), [wide / 2]]
    )
    reach = [solid.reach(y, z, sign) for y in (0.0, 0.4 * wide) for z in (low + 0.01, high - 0.01)]
    skin = max(reach, key=lambda x: sign * x)
    xs = np.array([skin - sign * 0.05, skin + sign * 0.007])
    zs = np.array([low, low + 0.024, high - 0.024, high])
    plate = grid_block(np.sort(xs), columns, zs, SEAM)
    centre = plate.points[plate.faces].mean(axis=1)
    outer = np.abs(centre[:, 0] - xs[1]) < 1e-6
    plate.paint_faces(outer, PLATE if sign > 0 else REAR_PLATE)
    column = np.searchsorted(columns, centre[:, 1]) - 1
    plate.paint_faces(outer & (column % 2 == 1) & (np.abs(centre[:, 2] - low - 0.055) < 0.031), INK)
    return plate.surface()


def destination(solid: Solid, z: float) -> Surface:
    """A lit text, seven blocks wide, over the windscreen of a bus."""
    half = 0.7
    reach = solid.reach(0.0, z, 1.0)
    edges = np.linspace(-0.6, 0.6, 7)
    columns = np.sort(np.concatenate([[-half, half], edges - 0.06, edges + 0.06]))
    zs = np.array([z - 0.1, z - 0.06, z + 0.06, z + 0.1])
    sign = grid_block(np.array([reach - 0.1, reach + 0.003]), columns, zs, TRIM)
    centre = sign.points[sign.faces].mean(axis=1)
    lit = (np.searchsorted(columns, centre[:, 1]) % 2 == 0) & (np.abs(centre[:, 2] - z) < 0.06)
    sign.paint_faces(lit & (centre[:, 0] > reach), DISPLAY)
    return sign.surface()


def pipe(solid: Solid, y: float, z: float) -> Surface:
    """An exhaust pipe at the rear."""
    x = solid.reach(abs(y), z, -1.0)
    return pebble((x + 0.03, y, z), (0.08, 0.13, 0.06), CHROME, 4.0, (4, 10)).surface()


def front_face(solid: Solid, p: VehicleSizes, end: float, edge: float) -> Parts:
    """Paint the front of half a body; returns the parts that are set into it.

    Args:
        end: x of the foremost point.
        edge: height of the face's upper edge: the bonnet's leading edge.
    """
    near = end - 0.55
    top = edge - 0.07
    _headlamp(solid, p, end, top)
    grille_low = top - p.grille_height
    intake = p.ground_clearance + 0.07

    def grille(s: Solid) -> Array:
        half = p.grille_width / 2 * (0.82 + 0.18 * (s.z - grille_low) / p.grille_height)
        return rounded([s.y - half, s.z - top, grille_low - s.z], 0.04, near - s.x)

    def lower(s: Solid) -> Array:
        rise = s.z - intake
        fields = [s.y - 0.36 * p.width - 0.3 * rise, -rise, rise - p.intake_height]
        return rounded(fields, 0.03, near - s.x)

    if p.chrome:
        solid.paint(lambda s: grille(s) - 0.02, CHROME, over=("paint",))
    solid.paint(grille, TRIM, over=("paint", "chrome"))
    for k in range(p.grille_bars):
        height = grille_low + p.grille_height * (k + 1) / (p.grille_bars + 1)

        def bar(s: Solid, height: float = height) -> Area:
            return strip(s.z - height, 0.009), [grille(s) + 0.01]

        solid.paint(bar, CHROME, over=("plastic",))
    solid.paint(lower, TRIM, over=("paint",))

    # Pockets of the fog lamps.
    centre = (0.385 * p.width, intake + 0.09)
    solid.paint(
        lambda s: (rectangle(s.y, s.z, centre, (0.17, 0.11)), [end - 0.6 - s.x]),
        TRIM,
        over=("paint", "plastic"),
    )
    parts: Parts = []
    for name, y, z, radius, finish in _spots(p, top):
        for side, sign in (("left", 1), ("right", -1)):
            parts.append((f"{name}-{side}", disc(solid, sign * y, z, 1.0, radius, finish)))
    parts.append(("badge", badge(solid, top - min(0.5 * p.grille_height, 0.09), 1.0)))
    parts.append(("plate-front", number_plate(solid, intake + p.intake_height + 0.02, 1.0)))
    return parts


def _spots(p: VehicleSizes, top: float) -> Iterator[tuple[str, float, float, float, Finish]]:
    """Round lamps: name, y, z, radius and finish."""
    inner, middle = p.width / 2 - p.lamp_width, top - 0.5 * p.lamp_height
    for k, share in enumerate((0.27, 0.55)):
        along = share * min(p.lamp_width, 0.46)
        height = middle + 0.85 * p.lamp_slant * (along - 0.22)
        yield f"projector-{k}", inner + along, height, min(0.33 * p.lamp_height, 0.05), PROJECTOR
    yield "fog-lamp", 0.385 * p.width, p.ground_clearance + 0.16, 0.035, LAMP


def _headlamp(solid: Solid, p: VehicleSizes, end: float, top: float) -> None:
    outer = p.width / 2
    inner = outer - p.lamp_width
    low = top - p.lamp_height

    def rise(s: Solid) -> Array:
        # Along the skin from the inner end outwards, round the corner and back.
        return p.lamp_slant * ((s.y - inner) + 0.8 * (end - s.x) - 0.3)

    def lamp(s: Solid) -> Array:
        ends = [inner - s.y + 0.4 * (s.z - low), end - 0.5 - 0.12 * p.lamp_slant - s.x]
        return smooth_max([*ends, low + rise(s) - s.z, s.z - top - 0.7 * rise(s) - 0.01], 0.05)

    def daylight(s: Solid) -> Area:
        return strip(s.z - low - rise(s) - 0.028, 0.012), [lamp(s) + 0.012]

    def indicator(s: Solid) -> Area:
        return strip(s.x - end + 0.37, 0.025), [lamp(s) + 0.012]

    solid.paint(lamp, BEZEL)
    solid.paint(lambda s: lamp(s) + 0.014, LAMP)
    solid.paint(daylight, DAYLIGHT, over=("headlamp",))
    solid.paint(indicator, INDICATOR, over=("headlamp",))


def rear_face(
    solid: Solid, p: VehicleSizes, end: float, top: float, plate_low: float, exhaust: bool
) -> Parts:
    """Paint the rear of half a body; returns the parts that are set into it.

    Args:
        end: x of the rearmost point.
        top: height of the tail lamps' upper edge.
        plate_low: height of the plate's lower edge.
        exhaust: bright pipes in the bumper.
    """
    sill, near, gate = p.ground_clearance, end + 0.5, 0.4 * p.width
    foot = min(plate_low - 0.05, top - 0.2)

    def apron(s: Solid) -> Array:
        edge = s.z - sill - 0.15 + 0.25 * np.maximum(s.y - 0.3 * p.width, 0)
        return rounded([edge, s.y - 0.44 * p.width], 0.04, s.x - near)

    def gate_edge(s: Solid) -> Area:
        return strip(s.y - gate, 0.005), [s.x - near, foot - s.z, s.z - top - 0.25]

    def gate_foot(s: Solid) -> Area:
        return strip(s.z - foot, 0.006), [s.x - near, s.y - gate]

    def reflector(s: Solid) -> Area:
        return rectangle(s.y, s.z, (0.38 * p.width, sill + 0.19), (0.16, 0.04)), [s.x - near]

    solid.paint(apron, TRIM, over=("paint",))
    tail_lamp(solid, p, end, top)
    solid.paint(gate_edge, SEAM, over=("paint",))
    solid.paint(gate_foot, SEAM, over=("paint",))
    solid.paint(reflector, TAIL, over=("paint", "plastic"))
    parts: Parts = [
        ("badge-rear", badge(solid, top - 0.05, -1.0, 0.04)),
        ("plate-rear", number_plate(solid, plate_low, -1.0)),
    ]
    if exhaust:
        for side, sign in (("left", 1), ("right", -1)):
            parts.append((f"pipe-{side}", pipe(solid, sign * 0.3 * p.width, sill + 0.06)))
    return parts


def tail_lamp(solid: Solid, p: VehicleSizes, end: float, top: float) -> None:
    """A lamp at the corner, upright where it is higher than wide, with indicator and reverse."""
    inner = p.width / 2 - p.tail_width
    low = top - p.tail_height
    reach = 0.1 if p.tail_height > 1.5 * p.tail_width else 0.3
    upright = p.tail_height > p.tail_width

    def lamp(s: Solid) -> Array:
        back = s.x - end - 0.25
        ends = [inner - s.y + (0.03 if upright else 0.25) * (s.z - low), s.x - end - reach - 0.06]
        return smooth_max([*ends, low - s.z + 0.08 * back, s.z - top - 0.1 * back], 0.04)

    solid.paint(lamp, BEZEL)
    solid.paint(lambda s: lamp(s) + 0.011, TAIL)

    def band(s: Solid, start: float, stop: float) -> Area:
        along, size = (s.z - low, p.tail_height) if upright else (s.y - inner, p.tail_width)
        return [start * size - along, along - stop * size], [lamp(s) + 0.011]

    solid.paint(lambda s: band(s, 0.05, 0.2), REVERSE, over=("taillamp",))
    solid.paint(lambda s: band(s, 0.22, 0.34), INDICATOR, over=("taillamp",))


def seam(
    solid: Solid,
    axis: int,
    at: float,
    across: tuple[float, float],
    half: float = 0.0045,
    tilt: float = 0.0,
) -> None:
    """A dark joint on the flanks: upright (axis 0, at x) or level (axis 2, at z).

    Args:
        solid: half of the body.
        axis: 0 or 2.
        at: metres on that axis.
        across: start and end of the joint on the other axis, metres.
        half: half its width.
        tilt: metres of x per metre of height.
    """

    def fields(s: Solid) -> Area:
        main, other = (s.x, s.z) if axis == 0 else (s.z, s.x)
        distance = main - at + (tilt * (s.z - across[0]) if axis == 0 else 0)
        return strip(distance, half), [across[0] - other, other - across[1], 0.93 - s.across]

    solid.paint(fields, SEAM, over=("paint", "plastic"))


def doors(solid: Solid, body: LoftedBody, p: VehicleSizes, edges: list[float]) -> None:
    """Joints of doors whose upright edges are at these x, from the front backwards."""
    sill = p.ground_clearance + 0.09
    for k, x in enumerate(edges):
        foot = sill
        last = k == len(edges) - 1
        ax, az, radius = body.arches[1]
        if last and len(edges) > 2 and abs(x - ax) < radius + 0.03:
            foot = az + np.sqrt(max((radius + 0.03) ** 2 - (x - ax) ** 2, 0.0))
        top = float(body.belt_at(np.array(x))) + (0.0 if k == 0 else 0.01)
        seam(solid, 0, x, (foot, top), tilt=0.06 if k else -0.02)
    seam(solid, 2, sill, (max(edges[-1], body.arches[1][0] + body.arches[1][2]), edges[0]))
