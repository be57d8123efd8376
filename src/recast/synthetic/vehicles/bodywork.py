"""What a body shows: lamps, grilles, badges, plates, tailgate, bumpers, doors and seams."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from recast.arrays import Array
from recast.synthetic.surface import Surface
from recast.synthetic.vehicles.fittings import Parts, grid_block, pebble
from recast.synthetic.vehicles.loft import LoftedBody
from recast.synthetic.vehicles.parameters import VehicleSizes
from recast.synthetic.vehicles.solid import (
    BEZEL,
    CHROME,
    DAYLIGHT,
    DISPLAY,
    INDICATOR,
    INK,
    LAMP,
    PLATE,
    PROJECTOR,
    REAR_PLATE,
    REVERSE,
    SEAM,
    TAIL,
    TRIM,
    Area,
    Finish,
    Solid,
    rectangle,
    rounded,
    smooth_max,
    strip,
)


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
