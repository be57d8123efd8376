"""The kinds of vehicle: hatchbacks to vans, the shape of one body; box trucks; and city buses."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from recast.arrays import Array
from recast.synthetic.surface import Surface, at
from recast.synthetic.vehicles import bodywork
from recast.synthetic.vehicles.bodywork import (
    Parts,
    SideGlass,
    destination,
    doors,
    face_window,
    front_face,
    number_plate,
    rear_face,
    screen,
    seam,
    side_windows,
    tail_lamp,
    wheel,
)
from recast.synthetic.vehicles.parameters import VehicleSizes
from recast.synthetic.vehicles.solid import (
    CHROME,
    CLADDING,
    GLASS,
    INDICATOR,
    REVERSE,
    SEAM,
    STEEL,
    TAIL,
    TRIM,
    UNDERSIDE,
    Area,
    Finish,
    LoftedBody,
    LoftProfile,
    Solid,
    rectangle,
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


Span = tuple[float, float]
BOX = Finish((0.68, 0.68, 0.67), "plastic")


def box_truck(p: VehicleSizes, paint: Finish) -> Parts:
    """Closed parts of a truck: cab, frame and load box; heights above the ground."""
    end = p.length / 2
    cab_length = p.length - p.box_length - 0.12
    offset = end - cab_length / 2
    cab = replace(p, width=0.92 * p.width, height=p.cab_height, cladding=0.05)
    made = _cab(cab, paint, cab_length, p.axles[0] - offset)
    parts: Parts = [(name, at(part, offset, 0.0)) for name, part in made]
    floor = 2 * p.wheel_radius + 0.14
    parts.append(("box", at(_load_box(p, paint, floor), -end + p.box_length / 2, 0.0)))
    parts += _frame(p, floor, end - cab_length)
    return parts + bodywork.steel_wheels(p)


def _cab(p: VehicleSizes, paint: Finish, length: float, axle: float) -> Parts:
    end = length / 2
    roof = p.height - p.roof_arch
    run = (roof - p.cowl_height) * float(np.tan(p.windscreen_rake))
    brow = p.bonnet_length + run
    top = LoftProfile.rounded(
        [
            (0.0, p.nose_height, 0.0),
            (p.bonnet_length, p.cowl_height, 0.12),
            (brow, roof, 0.3),
            (brow + 0.45 * (length - brow), p.height, 0.5),
            (length, p.height - 0.04, 0.0),
        ]
    )
    arch = p.wheel_radius + 0.06
    body = LoftedBody(
        length=length,
        width=p.width,
        top=top,
        bottom=p.ground_clearance,
        belt=p.belt_height,
        rise=0.0,
        tumblehome=p.tumblehome,
        crown=0.07,
        wrap=0.1,
        bow_front=p.bow,
        bow_rear=0.0,
        lean_front=0.1,
        lean_rear=0.0,
        corner=p.corner,
        taper=0.02,
        edge=0.14,
        arches=((axle, p.wheel_radius, arch), (axle, p.wheel_radius, arch)),
        flare=p.flare,
        bumper=0.65,
        cells=(20, 5, 11),
    )
    solid = body.half(paint)
    underside(solid, p)
    cowl = end - p.bonnet_length
    screen(solid, body, cowl - run + 0.05, cowl - 0.02, 0.08)
    back = max(-end + 0.16, cowl - run - 1.05)
    side_windows(solid, body, SideGlass(back + 0.05, 0.0, 0.12, sill=0.02), [], False)
    doors(solid, body, p, [min(cowl - 0.12, end - 0.3), back])
    set_in = front_face(solid, p, end, p.nose_height)
    wheel_wells(solid, replace(body, arches=body.arches[:1]), p)
    parts: Parts = [("cab", solid.mirrored().surface()), *set_in]
    x, z = min(cowl - 0.16, end - 0.32), p.belt_height + 0.12
    y = float(body.half_width(np.array(x), np.array(z)))
    pieces = bodywork.mirror(x, y, z, paint, tall=True)
    side: Parts = [(f"mirror-{k}", piece.surface()) for k, piece in enumerate(pieces)]
    hx = back + 0.15
    hy = float(body.half_width(np.array(hx), np.array(p.belt_height - 0.12)))
    side.append(("handle", bodywork.handle(hx, hy, p.belt_height - 0.12, TRIM).surface()))
    return parts + bodywork.both(side)


def _load_box(p: VehicleSizes, paint: Finish, floor: float) -> Surface:
    top = LoftProfile.rounded([(0.0, p.height, 0.0), (p.box_length, p.height, 0.0)])
    body = LoftedBody(
        length=p.box_length,
        width=p.width,
        top=top,
        bottom=floor,
        belt=floor + 0.9,
        rise=0.0,
        tumblehome=0.0,
        crown=0.0,
        wrap=0.0,
        bow_front=0.0,
        bow_rear=0.0,
        lean_front=0.0,
        lean_rear=0.0,
        corner=0.05,
        taper=0.0,
        edge=0.05,
        bumper=floor,
        cells=(14, 3, 7),
    )
    solid = body.half(paint if p.shade > 0.45 else BOX)
    bright = ("paint", "plastic")
    near = p.box_length / 2 - 0.06
    ends = (floor, p.height)
    # Aluminium edges, a band of the firm's colour, and two doors behind.
    solid.paint(lambda s: s.z - floor - 0.09, STEEL)
    solid.paint(lambda s: p.height - 0.07 - s.z, STEEL)
    if p.shade < 0.0:
        low = floor + 0.45 * (p.height - floor)
        solid.paint(lambda s: ([low - s.z, s.z - low - 0.42], [np.abs(s.x) - near]), paint, bright)
    seam(solid, 0, near - 0.04, ends, half=0.012)
    for y in (0.0, p.width / 2 - 0.09):

        def joint(s: Solid, y: float = y) -> Area:
            return strip(s.y - y, 0.008), [s.x + near]

        solid.paint(joint, SEAM)

    def bar(s: Solid) -> Area:
        limits = [s.x + near, floor + 0.12 - s.z, s.z - p.height + 0.1]
        return strip(s.y - 0.28 * p.width, 0.02), limits

    solid.paint(bar, CHROME)
    return solid.mirrored().surface()


def _frame(p: VehicleSizes, floor: float, cab_rear: float) -> Parts:
    """Frame, bumper bar, lamps, side guards, mudguards and tank behind the cab."""
    end, half = p.length / 2, p.width / 2
    rear = p.axles[1]
    low = p.wheel_radius * 1.15

    def box(x: Span, y: Span, z: Span, finish: Finish) -> Surface:
        return bodywork.grid_block(np.array(x), np.array(y), np.array(z), finish).surface()

    wide = (-0.92 * half, 0.92 * half)
    bar = bodywork.block((-end, -0.3, low), (-end + 0.05, 0.3, low + 0.1), TRIM)
    parts = [
        ("frame", box((-end + 0.1, cab_rear + 0.1), (-0.42, 0.42), (low, floor - 0.02), UNDERSIDE)),
        ("bumper-bar", box((-end, -end + 0.1), wide, (low - 0.02, low + 0.13), STEEL)),
        ("plate-rear", number_plate(bar, low + 0.005, -1.0)),
    ]
    side: Parts = []
    lamps = (("tail", 0.78, 0.13, TAIL), ("turn", 0.88, 0.09, INDICATOR))
    for name, share, width, finish in (*lamps, ("reverse", 0.69, 0.07, REVERSE)):
        y = (share * half - width / 2, share * half + width / 2)
        lamp = box((-end - 0.004, -end + 0.08), y, (low + 0.14, low + 0.26), finish)
        side.append((f"lamp-{name}", lamp))
    guard = (rear + p.wheel_radius + 0.3, cab_rear - 0.15)
    for k, z in enumerate((0.48, 0.72)):
        plank = box(guard, (half - 0.12, half - 0.08), (z, z + 0.1), STEEL)
        side.append((f"guard-{k}", plank))
    place = ((guard[0] + guard[1]) / 2, half - 0.42, 0.68)
    tank = bodywork.pebble(place, (0.9, 0.5, 0.5), STEEL, 4.0, (6, 12))
    side.append(("tank", tank.surface()))
    for k, x in enumerate((rear - p.wheel_radius - 0.12, rear + p.wheel_radius + 0.1)):
        flap = box((x, x + 0.03), (half - 0.62, half - 0.05), (low - 0.12, floor), CLADDING)
        side.append((f"flap-{k}", flap))
    return parts + bodywork.both(side)


def bus(p: VehicleSizes, paint: Finish) -> Parts:
    """Closed parts of a city bus, doors on the right; heights above the ground."""
    end, half = p.length / 2, p.width / 2
    front, rear = p.axles
    roof = p.height - 0.16
    radius = p.wheel_radius
    top = LoftProfile.rounded(
        [
            (0.0, roof - 0.14, 0.0),
            (0.5, roof - 0.02, 0.5),
            (2.0, roof, 0.5),
            (p.length - 0.6, roof, 0.4),
            (p.length, roof - 0.1 - p.roof_drop, 0.0),
        ]
    )
    body = LoftedBody(
        length=p.length,
        width=p.width,
        top=top,
        bottom=p.ground_clearance,
        belt=p.belt_height,
        rise=0.08,
        tumblehome=p.tumblehome,
        crown=0.07,
        wrap=0.0,
        bow_front=p.bow,
        bow_rear=0.05,
        lean_front=float(np.tan(p.windscreen_rake)),
        lean_rear=0.02,
        corner=p.corner,
        taper=0.01,
        edge=0.16,
        arches=((front, radius, radius + 0.06), (rear, radius, radius + 0.06)),
        bumper=0.7,
        cells=(28, 4, 7),
    )
    solid = body.half(paint)
    underside(solid, p)
    high = roof - 0.42
    _side_band(solid, p, high)
    face_window(solid, 1.0, end - 0.5, half - 0.1, p.cowl_height - 0.05, high - 0.02)
    # The dark brow over the windscreen, with the lit destination in it.
    solid.paint(
        lambda s: rounded(
            [high - 0.04 - s.z, s.z - roof + 0.1, s.y - half + 0.14], 0.05, end - 0.5 - s.x
        ),
        GLASS,
    )
    sign = destination(solid, (high + roof - 0.1) / 2)
    set_in = [("destination", sign), *front_face(solid, p, end, p.nose_height)]
    face_window(solid, -1.0, -end + 0.4, half - 0.3, p.belt_height + 0.35, high)
    tail_lamp(solid, p, -end, 1.0 + p.tail_height)
    tail_lamp(solid, replace(p, tail_height=0.14, tail_width=0.2), -end, roof - 0.2)
    _engine_grille(solid, p, -end)
    set_in.append(("plate-rear", number_plate(solid, p.ground_clearance + 0.28, -1.0)))
    wheel_wells(solid, body, p)
    whole = solid.mirrored()
    _bus_doors(whole, p)
    parts: Parts = [("body", whole.surface()), *set_in]
    size = (0.26 * p.length, 0.7 * p.width, 0.3)
    pod = bodywork.pebble((-0.1 * p.length, 0, p.height - 0.15), size, paint, 5.0, (8, 16))
    parts.append(("air-conditioning", pod.surface()))
    arm = ((end + 0.02, half - 0.05, high + 0.05), (0.5, 0.06, 0.06), TRIM, 4.0, (4, 8))
    shell = ((end + 0.2, half + 0.02, high - 0.22), (0.12, 0.2, 0.5), TRIM, 3.0, (8, 10))
    mirrors = [("mirror", bodywork.pebble(*shape).surface()) for shape in (arm, shell)]
    parts += bodywork.both(mirrors)
    return parts + bodywork.steel_wheels(p)


def _side_band(solid: Solid, p: VehicleSizes, high: float) -> None:
    """The dark band of side windows, divided by thin posts."""
    end = p.length / 2

    def band(s: Solid) -> Array:
        fields = [p.belt_height - s.z, s.z - high, s.x - end + 0.5, -end + 0.55 - s.x]
        return rounded(fields, 0.1, 0.8 - s.across)

    solid.paint(lambda s: band(s) - 0.03, TRIM)
    solid.paint(band, GLASS)
    panes = p.side_windows + 1
    for k in range(1, panes):
        x = end - 0.5 - k * (p.length - 1.05) / panes

        def post(s: Solid, x: float = x) -> Area:
            return strip(s.x - x, 0.045), [band(s)]

        solid.paint(post, TRIM, over=("glass",))
    # The line of the opening flaps.
    solid.paint(lambda s: (strip(s.z - high + 0.32, 0.014), [band(s) + 0.05]), TRIM, ("glass",))
    seam(solid, 2, p.ground_clearance + 0.5, (-end + 0.3, end - 0.3), half=0.006)


def _engine_grille(solid: Solid, p: VehicleSizes, end: float) -> None:
    low = p.ground_clearance + 0.5

    def area(s: Solid) -> Array:
        fields = [s.y - 0.3 * p.width, low - s.z, s.z - p.belt_height - 0.1]
        return rounded(fields, 0.05, s.x - end - 0.3)

    solid.paint(area, CLADDING)
    for k in range(3):

        def slat(s: Solid, k: int = k) -> Area:
            return strip(s.z - low - 0.1 - 0.14 * k, 0.03), [area(s) + 0.04]

        solid.paint(slat, SEAM, over=("plastic",))


def _bus_doors(solid: Solid, p: VehicleSizes) -> None:
    """Two glazed doors on the right side: ahead of the front wheel and between the axles."""
    front, _ = p.axles
    low, high = p.ground_clearance + 0.07, p.height - 0.75
    first = (front + p.wheel_radius + 0.12, p.length / 2 - 0.38)
    second = (front - p.wheel_radius - 2.9, front - p.wheel_radius - 1.6)

    def pane(s: Solid, x: float, width: float, tall: float) -> Area:
        return rectangle(s.x, s.z, (x, (low + high) / 2), (width, tall)), [s.across + 0.8]

    for start, stop in (first, second):
        middle, width, tall = (start + stop) / 2, stop - start, high - low
        solid.paint(partial(pane, x=middle, width=width, tall=tall), TRIM)
        for x in (middle - 0.25 * width, middle + 0.25 * width):
            leaf = partial(pane, x=x, width=0.5 * width - 0.09, tall=tall - 0.16)
            solid.paint(leaf, GLASS)
