"""Box trucks: cab, frame and load box."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.surface import Surface
from recast.synthetic.vehicles import fittings
from recast.synthetic.vehicles.details import Parts, number_plate
from recast.synthetic.vehicles.finishes import (
    CHROME,
    CLADDING,
    INDICATOR,
    REVERSE,
    SEAM,
    STEEL,
    TAIL,
    TRIM,
    UNDERSIDE,
    Area,
    strip,
    xyz,
)
from recast.synthetic.vehicles.front import front_face
from recast.synthetic.vehicles.glazing import SideGlass, screen, side_windows
from recast.synthetic.vehicles.loft import Body
from recast.synthetic.vehicles.panels import doors, seam, underside, wheel_wells
from recast.synthetic.vehicles.parameters import VehicleParameters
from recast.synthetic.vehicles.profile import Profile
from recast.synthetic.vehicles.solid import Finish, Solid
from recast.synthetic.vehicles.wheels import steel_wheels

Array = NDArray[np.float64]
BOX = Finish((0.68, 0.68, 0.67), "plastic")


def box_truck(p: VehicleParameters, paint: Finish) -> Parts:
    """Closed parts of a truck: cab, frame and load box; heights above the ground."""
    end = p.length / 2
    front, rear = p.axles
    cab_length = p.length - p.box_length - 0.12
    offset = end - cab_length / 2
    cab = replace(p, width=0.92 * p.width, height=p.cab_height, cladding=0.05)
    parts: Parts = []
    for name, part in _cab(cab, paint, cab_length, front - offset):
        pose = np.eye(4)
        pose[0, 3] = offset
        parts.append((name, part.transformed(pose)))
    floor = 2 * p.wheel_radius + 0.14
    box = _load_box(p, paint, floor)
    pose = np.eye(4)
    pose[0, 3] = -end + p.box_length / 2
    parts.append(("box", box.transformed(pose)))
    parts += _frame(p, floor, end - cab_length)
    return parts + steel_wheels(p, [front], [rear])


def _cab(p: VehicleParameters, paint: Finish, length: float, axle: float) -> Parts:
    end = length / 2
    roof = p.height - p.roof_arch
    run = (roof - p.cowl_height) * float(np.tan(p.windscreen_rake))
    brow = p.bonnet_length + run
    top = Profile.rounded(
        [(0.0, p.nose_height, 0.0), (p.bonnet_length, p.cowl_height, 0.12), (brow, roof, 0.3),
         (brow + 0.45 * (length - brow), p.height, 0.5), (length, p.height - 0.04, 0.0)]
    )  # fmt: skip
    arch = p.wheel_radius + 0.06
    body = Body(
        length=length, width=p.width, top=top, bottom=p.ground_clearance, belt=p.belt_height,
        rise=0.0, tumblehome=p.tumblehome, crown=0.07, wrap=0.1, bow_front=p.bow, bow_rear=0.0,
        lean_front=0.1, lean_rear=0.0, corner=p.corner, taper=0.02, edge=0.14,
        arches=((axle, p.wheel_radius, arch), (axle, p.wheel_radius, arch)), flare=p.flare,
        bumper=0.65, cells=(20, 5, 11),
    )  # fmt: skip
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
    pieces = fittings.mirror(x, y, z, paint, tall=True)
    side: Parts = [(f"mirror-{k}", piece.surface()) for k, piece in enumerate(pieces)]
    hx = back + 0.15
    hy = float(body.half_width(np.array(hx), np.array(p.belt_height - 0.12)))
    side.append(("handle", fittings.handle(hx, hy, p.belt_height - 0.12, TRIM).surface()))
    return parts + fittings.both(side)


def _load_box(p: VehicleParameters, paint: Finish, floor: float) -> Surface:
    top = Profile.rounded([(0.0, p.height, 0.0), (p.box_length, p.height, 0.0)])
    body = Body(
        length=p.box_length, width=p.width, top=top, bottom=floor, belt=floor + 0.9, rise=0.0,
        tumblehome=0.0, crown=0.0, wrap=0.0, bow_front=0.0, bow_rear=0.0, lean_front=0.0,
        lean_rear=0.0, corner=0.05, taper=0.0, edge=0.05, bumper=floor, cells=(14, 3, 7),
    )  # fmt: skip
    solid = body.half(paint if p.shade > 0.45 else BOX)
    bright = ("paint", "plastic")
    near = p.box_length / 2 - 0.06
    ends = (floor, p.height)
    # Aluminium edges, a band of the firm's colour, and two doors behind.
    solid.paint(lambda s: s.points[:, 2] - floor - 0.09, STEEL)
    solid.paint(lambda s: p.height - 0.07 - s.points[:, 2], STEEL)
    if p.shade < 0.0:
        low = floor + 0.45 * (p.height - floor)
        solid.paint(lambda s: ([low - s.points[:, 2], s.points[:, 2] - low - 0.42],
                               [np.abs(s.points[:, 0]) - near]), paint, bright)  # fmt: skip
    seam(solid, 0, near - 0.04, ends, half=0.012)
    for y in (0.0, p.width / 2 - 0.09):

        def joint(s: Solid, y: float = y) -> Area:
            return strip(s.points[:, 1] - y, 0.008), [s.points[:, 0] + near]

        solid.paint(joint, SEAM)

    def bar(s: Solid) -> Area:
        x, y, z = xyz(s)
        return strip(y - 0.28 * p.width, 0.02), [x + near, floor + 0.12 - z, z - p.height + 0.1]

    solid.paint(bar, CHROME)
    return solid.mirrored().surface()


def _frame(p: VehicleParameters, floor: float, cab_rear: float) -> Parts:
    """Frame, bumper bar, lamps, side guards, mudguards and tank behind the cab."""
    end, half = p.length / 2, p.width / 2
    rear = p.axles[1]
    low = p.wheel_radius * 1.15
    parts: Parts = [
        ("frame", fittings.block((-end + 0.1, -0.42, low), (cab_rear + 0.1, 0.42, floor - 0.02),
                                 UNDERSIDE).surface()),
        ("bumper-bar", fittings.block((-end, -0.92 * half, low - 0.02), (-end + 0.1, 0.92 * half,
                                      low + 0.13), STEEL).surface()),
    ]  # fmt: skip
    bar = fittings.block((-end, -0.3, low), (-end + 0.05, 0.3, low + 0.1), TRIM)
    parts.append(("plate-rear", number_plate(bar, low + 0.005, -1.0)))
    side: Parts = []
    for name, y, wide, finish in (("tail", 0.78, 0.13, TAIL), ("turn", 0.88, 0.09, INDICATOR),
                                  ("reverse", 0.69, 0.07, REVERSE)):  # fmt: skip
        block = fittings.block((-end - 0.004, y * half - wide / 2, low + 0.14),
                               (-end + 0.08, y * half + wide / 2, low + 0.26), finish)  # fmt: skip
        side.append((f"lamp-{name}", block.surface()))
    guard = (rear + p.wheel_radius + 0.3, cab_rear - 0.15)
    for k, z in enumerate((0.48, 0.72)):
        plank = fittings.block((guard[0], half - 0.12, z), (guard[1], half - 0.08, z + 0.1), STEEL)
        side.append((f"guard-{k}", plank.surface()))
    place = ((guard[0] + guard[1]) / 2, half - 0.42, 0.68)
    tank = fittings.pebble(place, (0.9, 0.5, 0.5), STEEL, 4.0, (6, 12))
    side.append(("tank", tank.surface()))
    for k, x in enumerate((rear - p.wheel_radius - 0.12, rear + p.wheel_radius + 0.1)):
        flap = fittings.block(
            (x, half - 0.62, low - 0.12), (x + 0.03, half - 0.05, floor), CLADDING
        )
        side.append((f"flap-{k}", flap.surface()))
    return parts + fittings.both(side)
