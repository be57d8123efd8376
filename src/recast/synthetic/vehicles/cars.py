"""Hatchbacks, sedans, estates, SUVs, pickups and vans: the shape of one body, and its openings."""

from __future__ import annotations

import numpy as np

from recast.arrays import Array
from recast.synthetic.surface import at
from recast.synthetic.vehicles import bodywork
from recast.synthetic.vehicles.bodywork import (
    Parts,
    SideGlass,
    doors,
    front_face,
    rear_face,
    screen,
    seam,
    side_windows,
    wheel,
)
from recast.synthetic.vehicles.parameters import VehicleSizes
from recast.synthetic.vehicles.solid import (
    CHROME,
    CLADDING,
    GLASS,
    SEAM,
    TRIM,
    Area,
    Finish,
    LoftedBody,
    LoftProfile,
    Solid,
    rounded,
    strip,
    underside,
    wheel_wells,
)


def car_body(p: VehicleSizes) -> LoftedBody:
    """The shape of the body."""
    front, rear = p.axles
    radius = p.wheel_radius
    gap = 1.12 if p.kind in ("suv", "pickup") else 1.09
    boxy = p.kind == "van"
    return LoftedBody(
        length=p.length,
        width=p.width,
        top=_outline(p),
        bottom=p.ground_clearance,
        belt=p.belt_height + p.wedge * front,
        wedge=p.wedge,
        tumblehome=p.tumblehome,
        shoulder=p.shoulder,
        crown=0.06 if boxy else 0.05,
        wrap=0.16 if boxy else 0.14,
        wrap_rear=0.0 if boxy else min(0.14, 0.25 * p.rear_rake),
        bow_front=p.bow,
        bow_rear=0.4 * p.bow,
        lean_front=0.22 if not boxy else 0.12,
        lean_rear=float(np.tan(p.rear_rake)) if boxy else 0.1,
        corner=p.corner,
        taper=0.05,
        edge=0.11,
        arches=((front, radius, gap * radius + 0.01), (rear, radius, gap * radius + 0.01)),
        flare=p.flare,
        crease=p.crease,
        bumper=0.5 * (p.ground_clearance + p.nose_height) - 0.05,
        cells=(34, 4, 9),
    )


def screen_run(p: VehicleSizes) -> float:
    """Length of the windscreen seen from above."""
    return (p.height - p.roof_arch - p.cowl_height) * float(np.tan(p.windscreen_rake))


def _outline(p: VehicleSizes) -> LoftProfile:
    roof = p.height - p.roof_arch
    screen_end = p.bonnet_length + screen_run(p)
    deck = p.length - p.deck_length
    gutter_height = p.height - p.roof_drop
    gutter = deck - (gutter_height - p.deck_height) * float(np.tan(p.rear_rake))
    gutter = max(gutter, screen_end + 0.2)
    peak = screen_end + 0.35 * (gutter - screen_end)
    half = 0.5 * p.bonnet_length
    rise = p.cowl_height - p.nose_height
    bed = p.kind == "pickup"
    if p.kind == "van":
        # The rear is one upright face up to the roof.
        tail = [(p.length - 0.25, gutter_height + 0.02, 0.3), (p.length, gutter_height - 0.03, 0.0)]
    else:
        tail = [
            (gutter, gutter_height, 0.12 if p.rear_rake < 0.4 else 0.25),
            (deck, p.deck_height, 0.06 if bed else 0.12),
            (p.length, p.deck_height - (0.0 if bed else 0.02), 0.0),
        ]
    return LoftProfile.rounded(
        [
            (0.0, p.nose_height, 0.0),
            (half, p.nose_height + 0.66 * rise, 0.4),
            (p.bonnet_length, p.cowl_height, 0.12),
            (screen_end, roof, 0.3),
            (peak, p.height, 0.6),
            *tail,
        ]
    )


def side_layout(
    p: VehicleSizes, body: LoftedBody, gutter: float
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


def rear_window(
    solid: Solid, body: LoftedBody, p: VehicleSizes, deck: float, gutter: float
) -> None:
    """Glass in the rear, of the form that the kind has."""
    if p.kind == "van":
        _van_rear(solid, p)
    elif p.kind == "pickup":
        _cab_back(solid, p, deck, gutter)
    else:
        run = gutter - deck
        lower = deck + (0.06 if p.kind == "sedan" else 0.1 * run)
        upper = gutter - 0.04 * run - 0.02
        screen(solid, body, lower, upper, 0.1, low_z=p.deck_height + 0.05)


def _cab_back(solid: Solid, p: VehicleSizes, deck: float, gutter: float) -> None:
    def pane(s: Solid) -> Array:
        fields = [s.y - 0.34 * p.width, p.deck_height + 0.1 - s.z, s.z - p.height + 0.19]
        return rounded(fields, 0.06, s.x - gutter - 0.15, deck - 0.2 - s.x, 0.75 - s.up)

    solid.paint(pane, TRIM)
    solid.paint(lambda s: pane(s) + 0.03, GLASS)


def _van_rear(solid: Solid, p: VehicleSizes) -> None:
    """Two doors behind, glazed where the sides are."""
    rear = -p.length / 2
    low, high = p.belt_height + 0.05, p.height - 0.25

    def pane(s: Solid) -> Array:
        fields = [0.07 - s.y, s.y - 0.38 * p.width, low - s.z, s.z - min(high, low + 0.65)]
        return rounded(fields, 0.07, s.x - rear - 0.4)

    solid.paint(lambda s: (strip(s.y, 0.005), [s.x - rear - 0.3]), SEAM)
    if p.side_windows:
        solid.paint(lambda s: pane(s) - 0.02, TRIM)
        solid.paint(pane, GLASS)


def open_bed(solid: Solid, p: VehicleSizes, front: float, rear: float) -> None:
    """Hollow out the bed of a pickup between two x."""
    # Above the wheel wells.
    floor = p.wheel_radius * 2.12 + 0.06

    def area(s: Solid) -> Array:
        fields = [s.x - front + 0.06, rear + 0.17 - s.x, s.y - p.width / 2 + 0.13]
        return rounded(fields, 0.04, 0.8 - s.up)

    def down(points: Array) -> Array:
        moved = points.copy()
        moved[:, 2] = floor
        return moved

    solid.paint(lambda s: area(s) - 0.06, TRIM)
    solid.push(area, down, CLADDING)


def car(p: VehicleSizes, paint: Finish) -> Parts:
    """Closed parts of a car, by name; heights above the ground."""
    body = car_body(p)
    solid = body.half(paint)
    end = p.length / 2
    cowl, brow = end - p.bonnet_length, end - p.bonnet_length - screen_run(p)
    deck = -end + p.deck_length
    gutter = deck + (p.height - p.roof_drop - p.deck_height) * np.tan(p.rear_rake)
    underside(solid, p)
    _bonnet_lines(solid, p, end, cowl)
    screen(solid, body, brow + 0.02, cowl - 0.07, 0.075)
    glass, pillars, edges = side_layout(p, body, gutter)
    side_windows(solid, body, glass, pillars, p.chrome)
    doors(solid, body, p, edges)
    rear_window(solid, body, p, deck, gutter)
    set_in = front_face(solid, p, end, p.nose_height)
    plate = {"sedan": 0.46, "pickup": 0.5, "van": 0.5, "suv": 0.55}.get(p.kind, 0.48)
    low = p.ground_clearance + plate * (p.deck_height - p.ground_clearance)
    top = {"van": 1.0, "sedan": 0.95, "pickup": 0.97}.get(p.kind, 0.97) * p.deck_height
    set_in += rear_face(solid, p, -end, top, low, exhaust=p.chrome and p.kind != "van")
    wheel_wells(solid, body, p)
    if p.kind == "pickup":
        open_bed(solid, p, deck, -end)
    parts: Parts = [("body", solid.mirrored().surface()), *set_in]
    side = _fittings(p, body, paint, cowl, edges, brow, gutter)
    return parts + bodywork.both(side)


def _bonnet_lines(solid: Solid, p: VehicleSizes, end: float, cowl: float) -> None:
    def sides(s: Solid) -> Area:
        off = s.y - 0.4 * p.width + 0.04 * (s.x - cowl)
        return strip(off, 0.004), [s.x - end + 0.16, cowl - 0.03 - s.x, 0.8 - s.up]

    if p.bonnet_length > 0.6:
        solid.paint(sides, SEAM, over=("paint",))

    # The cowl between bonnet and windscreen is black.
    def grille(s: Solid) -> Area:
        return [cowl - 0.08 - s.station, s.station - cowl + 0.005, s.across - 0.88], [0.8 - s.up]

    solid.paint(grille, TRIM)
    seam(solid, 0, end - 0.42, (p.ground_clearance + 0.1, p.nose_height - p.lamp_height - 0.1))


def _fittings(
    p: VehicleSizes,
    body: LoftedBody,
    paint: Finish,
    cowl: float,
    edges: list[float],
    brow: float,
    gutter: float,
) -> Parts:
    """Parts of the left side."""

    def skin(x: float, z: float) -> float:
        return float(body.half_width(np.array(x), np.array(z)))

    parts: Parts = []
    front, rear = p.axles
    turned = wheel(p.wheel_radius, p.tyre_width, p.rim_share, p.spokes, dished=False)
    y = p.width / 2 - p.tyre_width / 2 - 0.035
    for name, x in (("wheel-front", front), ("wheel-rear", rear)):
        parts.append((name, at(turned, x, y, p.wheel_radius)))
    mx = min(cowl - 0.38, edges[0] - 0.05) if p.kind != "van" else edges[0] - 0.1
    mz = float(body.belt_at(np.array(mx))) + 0.05
    pieces = bodywork.mirror(mx, skin(mx, mz) - 0.01, mz, paint, tall=p.kind == "van")
    parts += [("mirror", pieces[0].surface()), ("mirror-foot", pieces[1].surface())]
    finish = CHROME if p.chrome else paint
    for k, x in enumerate(edges[1:]):
        hx = x + 0.16
        hz = float(body.belt_at(np.array(hx))) - 0.1
        parts.append((f"handle-{k}", bodywork.handle(hx, skin(hx, hz), hz, finish).surface()))
    if p.roof_rails:
        start, stop = brow - 0.25, gutter + 0.25
        y = 0.5 * p.width - np.tan(p.tumblehome) * (p.height - p.belt_height) - 0.14
        z = [float(body.outline(np.array(x))) - 0.015 for x in (start, stop)]
        pieces = bodywork.rail((start, y, z[0]), (stop, y, z[1]))
        parts += [(f"rail-{k}", piece.surface()) for k, piece in enumerate(pieces)]
    return parts
