"""What the parts of a vehicle are made of, and which part each point of the body belongs to.

A material has a colour, and mirrors more or less of its surroundings. Parts are windows, lamps,
grille, doors and plates; which ones, the vehicle's design says.
"""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np

from recast.arrays import Array, Int64Array, Mask

if TYPE_CHECKING:
    from recast.actors.template.body import BodyPanels, TemplateBody
    from recast.actors.template.design import FrontDesign


PLATE_SIZES = {"long": (0.52, 0.115), "short": (0.33, 0.165)}
"""Width and height of number plates in metres: European; Japanese and American."""


class TemplateMaterial(IntEnum):
    """Label of a surface point."""

    PAINT = 0
    GLASS = 1
    TRIM = 2
    SEAM = 3
    TYRE = 4
    ALLOY = 5
    CHROME = 6
    LAMP = 7
    LAMP_CORE = 8
    AMBER = 9
    RED = 10
    RED_CORE = 11
    PLATE = 12
    INK = 13
    PLATE_BAND = 14
    DARK = 15
    GRILLE = 16
    HANDLE = 17
    SCREEN = 18
    DARK_GLASS = 19
    LAMP_FRAME = 20
    RED_FRAME = 21
    RED_DARK = 22
    REVERSE = 23
    TURN = 24
    GLOSS_BLACK = 25
    BAR = 26
    DARK_BAR = 27
    SILVER = 28
    REFLECTOR = 29
    DARK_ALLOY = 30
    COVER = 31
    WHEEL_GAP = 32


class BodyPart(IntEnum):
    """What a surface point belongs to."""

    PAINT = 0
    GLASS = 1
    WHEEL = 2
    HEAD_LAMP = 3
    TAIL_LAMP = 4
    PLATE = 5
    GRILLE = 6
    TRIM = 7
    DARK = 8


class VehiclePart(IntEnum):
    """What a surface point is, as far as its colour tells."""

    PAINT = 0
    GLASS = 1
    DARK = 2
    RED = 3
    CLEAR = 4
    PLATE = 5


_M, _P = TemplateMaterial, BodyPart
_FINISHES = {
    _M.PAINT: ((0.40, 0.41, 0.43), 1.0, 1.0, _P.PAINT),  # replaced by the observed paint
    _M.GLASS: ((0.12, 0.13, 0.14), 3.0, 0.0, _P.GLASS),
    _M.TRIM: ((0.15, 0.15, 0.16), 0.25, 0.0, _P.TRIM),
    # shut lines show a little of the body colour
    _M.SEAM: ((0.05, 0.05, 0.05), 0.3, 0.45, _P.PAINT),
    _M.TYRE: ((0.13, 0.13, 0.135), 0.1, 0.0, _P.WHEEL),
    _M.ALLOY: ((0.66, 0.67, 0.69), 1.2, 0.0, _P.WHEEL),
    _M.CHROME: ((0.72, 0.73, 0.75), 3.0, 0.0, _P.TRIM),
    _M.LAMP: ((0.54, 0.57, 0.60), 1.6, 0.0, _P.HEAD_LAMP),
    _M.LAMP_CORE: ((0.96, 0.97, 0.98), 0.6, 0.0, _P.HEAD_LAMP),
    _M.AMBER: ((0.80, 0.48, 0.20), 1.0, 0.0, _P.HEAD_LAMP),
    _M.RED: ((0.55, 0.05, 0.05), 1.0, 0.0, _P.TAIL_LAMP),
    _M.RED_CORE: ((0.80, 0.12, 0.10), 0.6, 0.0, _P.TAIL_LAMP),
    _M.PLATE: ((0.90, 0.90, 0.88), 0.2, 0.0, _P.PLATE),
    _M.INK: ((0.20, 0.20, 0.23), 0.2, 0.0, _P.PLATE),
    _M.PLATE_BAND: ((0.10, 0.20, 0.60), 0.2, 0.0, _P.PLATE),
    _M.DARK: ((0.03, 0.03, 0.03), 0.0, 0.0, _P.DARK),
    _M.GRILLE: ((0.08, 0.08, 0.085), 0.3, 0.0, _P.GRILLE),
    _M.HANDLE: ((0.40, 0.41, 0.43), 2.0, 1.0, _P.PAINT),  # paint too, see `PAINTED`
    _M.SCREEN: ((0.32, 0.34, 0.35), 3.8, 0.0, _P.GLASS),  # the dashboard shows, and the sky
    _M.DARK_GLASS: ((0.07, 0.07, 0.075), 2.6, 0.0, _P.GLASS),
    _M.LAMP_FRAME: ((0.10, 0.10, 0.11), 1.2, 0.0, _P.HEAD_LAMP),
    _M.RED_FRAME: ((0.16, 0.03, 0.03), 0.8, 0.0, _P.TAIL_LAMP),
    _M.RED_DARK: ((0.34, 0.03, 0.04), 1.2, 0.0, _P.TAIL_LAMP),
    _M.REVERSE: ((0.74, 0.72, 0.71), 1.2, 0.0, _P.TAIL_LAMP),
    _M.TURN: ((0.78, 0.40, 0.14), 1.0, 0.0, _P.TAIL_LAMP),
    _M.GLOSS_BLACK: ((0.05, 0.05, 0.055), 1.2, 0.0, _P.TRIM),
    _M.BAR: ((0.66, 0.67, 0.69), 2.5, 0.0, _P.GRILLE),
    _M.DARK_BAR: ((0.21, 0.21, 0.22), 1.0, 0.0, _P.GRILLE),
    _M.SILVER: ((0.62, 0.63, 0.64), 0.6, 0.0, _P.TRIM),
    _M.REFLECTOR: ((0.50, 0.06, 0.06), 0.8, 0.0, _P.TRIM),
    _M.DARK_ALLOY: ((0.20, 0.20, 0.21), 1.0, 0.0, _P.WHEEL),
    _M.COVER: ((0.56, 0.57, 0.58), 0.5, 0.0, _P.WHEEL),
    _M.WHEEL_GAP: ((0.05, 0.05, 0.05), 0.0, 0.0, _P.WHEEL),
}
"""Display colour; factor on the Fresnel reflection of a clear coat; share of the body colour."""

SRGB = np.array([_FINISHES[m][0] for m in TemplateMaterial])
"""(materials, 3) display colours."""
GLOSS = np.array([_FINISHES[m][1] for m in TemplateMaterial])
"""(materials,) factor on the Fresnel reflection of a clear coat."""
PAINTED = np.array([_FINISHES[m][2] for m in TemplateMaterial])
"""(materials,) share of the body colour."""
BODY_PART = np.array([int(_FINISHES[m][3]) for m in TemplateMaterial])
"""(materials,) `BodyPart` of each material."""
_CLEAR = {_M.LAMP, _M.LAMP_CORE, _M.REVERSE, _M.CHROME, _M.BAR, _M.SILVER}
_RED = {_M.RED, _M.RED_CORE, _M.RED_DARK, _M.AMBER, _M.TURN, _M.REFLECTOR}
_COLOURED = {
    VehiclePart.PAINT: {_M.PAINT, _M.HANDLE},
    VehiclePart.GLASS: {_M.GLASS, _M.SCREEN, _M.DARK_GLASS},
    VehiclePart.RED: _RED,
    VehiclePart.CLEAR: _CLEAR,
    VehiclePart.PLATE: {_M.PLATE, _M.PLATE_BAND},
}
_KINDS = {material: part for part, those in _COLOURED.items() for material in those}
PART_OF_MATERIAL = np.array([int(_KINDS.get(m, VehiclePart.DARK)) for m in TemplateMaterial])
"""(materials,) `VehiclePart` of each material."""
GLASS = (BODY_PART == BodyPart.GLASS).astype(float)
"""(materials,) 1 for windows."""
RIM = np.isin(np.arange(len(_FINISHES)), [_M.ALLOY, _M.DARK_ALLOY, _M.COVER]).astype(float)
"""(materials,) 1 for the metal of wheels."""

_LINE = 0.005  # metres: half width of shut lines
_BENT = 0.8  # arc around a corner over the distance behind the bumper


def label_body(
    body: TemplateBody, points: Array, normals: Array, panels: BodyPanels | None = None
) -> Int64Array:
    """Materials (N,) of body surface points (N, 3) with outward normals (N, 3).

    Args:
        panels: `body.panels(points)`, if known.
    """
    panels = body.panels(points) if panels is None else panels
    labels = np.full(len(points), int(TemplateMaterial.PAINT))
    top = points[:, 2] > 0.3 * body.height
    from_end = body.length / 2 - np.abs(points[:, 0])
    ahead = points[:, 0] > 0
    low = points[:, 2] < 1.1 * body.design.proportions.cowl_z * body.height
    regions = (
        (_sides, np.abs(normals[:, 1]) > 0.4),
        (_front, ahead & low & (normals[:, 0] > 0.02) & (from_end < 1.0)),
        (_bonnet, ahead & low & (normals[:, 2] > 0.5)),
        (_rear, ~ahead & (normals[:, 0] < -0.02) & (from_end < 1.0)),
        (_glass, top & (panels.lower > 0.01)),  # on the greenhouse, not on the body below
    )
    for paint, where in regions:
        index = np.flatnonzero(where)
        part = labels[index]
        paint(body, points[index], normals[index], panels.at(index), part)
        labels[index] = part
    labels[(normals[:, 2] < -0.75) & ~top] = TemplateMaterial.DARK
    labels[body.wells(points) < 0.004] = TemplateMaterial.DARK
    return labels


def _plate(
    size: tuple[float, float], labels: Int64Array, y: Array, z: Array, height: float, where: Mask
) -> None:
    """A number plate at `height`: frame, white field, blue band and strokes for characters."""
    w, h = size
    v = z - height
    labels[where & (np.abs(y) < w / 2 + 0.009) & (np.abs(v) < h / 2 + 0.009)] = _M.DARK_BAR
    field = where & (np.abs(y) < w / 2) & (np.abs(v) < h / 2)
    labels[field] = _M.PLATE
    u = y / (w / 2)
    long = w > 0.4
    if long:
        labels[field & (u < -0.9)] = _M.PLATE_BAND
    count = 5.2 if long else 2.6
    cell = np.abs((u + 1) * count % 1 - 0.5)
    written = np.abs(u) < (0.84 if long else 0.80)
    written &= np.abs(v + (0.0 if long else 0.02)) < (0.033 if long else 0.038)
    hole = (cell < 0.09) & (np.abs(v) < 0.018)
    labels[field & (cell < 0.28) & written & ~hole & (np.abs(u + 0.15) > 0.06)] = _M.INK
    if not long:  # the office in the upper line
        above = (np.abs(v - 0.055) < 0.012) & (np.abs(u) < 0.45)
        labels[field & above & (np.abs(u * 7 % 1 - 0.5) < 0.3)] = _M.INK


def _bonnet(
    body: TemplateBody, points: Array, normals: Array, panels: BodyPanels, labels: Int64Array
) -> None:
    """Shut lines beside the bonnet."""
    p, half = body.design.proportions, body.width / 2
    x, y, z = points.T
    behind = body.length / 2 - x
    top = (z < p.cowl_z * body.height + 0.03) & (x > body.x_at(p.cowl_x)) & (panels.lower < 0.01)
    line = 0.80 * half - 0.10 * half * np.clip(1 - behind / (p.cowl_x * body.length), 0, 1)
    labels[top & (np.abs(np.abs(y) - line) < _LINE)] = _M.SEAM


def _front(
    body: TemplateBody, points: Array, normals: Array, panels: BodyPanels, labels: Int64Array
) -> None:
    p, H, half = body.design.proportions, body.height, body.width / 2
    front = body.design.front
    x, y, z = points.T
    behind, across = body.length / 2 - x, np.abs(y)
    # from the middle around the corners
    u = half + np.maximum(panels.side, -0.9 * half) + _BENT * behind
    ahead = (normals[:, 0] > 0.25) & (behind < 0.5 * half + 0.2) & (z < 1.05 * p.cowl_z * H)
    lead = p.bonnet_z * H
    s = lead / 0.70  # heights scale with the height of the nose
    labels[ahead & (np.abs(z - lead + 0.012) < _LINE) & (across < 0.78 * half)] = _M.SEAM

    # lower bumper: apron, intake, fog lamps
    plastic = _M.GLOSS_BLACK if front.bumper == "body" else _M.TRIM
    floor = body.bumper_low + (0.02 if front.bumper == "body" else 0.08) * s
    centre = max(floor + front.intake_height / 2 + 0.015, 0.285 * s)
    upper = centre + front.intake_height / 2
    if front.bumper == "black":
        labels[ahead & (z < max(upper + 0.05, front.plate_z * lead + 0.09))] = _M.TRIM
    elif front.bumper == "skid":
        labels[ahead & (z < upper + 0.02) & (across > (front.intake_width - 0.1) * half)] = _M.TRIM
    labels[ahead & (z < floor)] = _M.TRIM
    wide = across - front.intake_width * half - 0.3 * (z - centre)
    intake = np.maximum(wide, np.abs(z - centre) - front.intake_height / 2)
    labels[ahead & (intake < 0)] = _M.GRILLE
    rungs = np.abs((z - centre) / 0.036 % 1 - 0.5) > 0.36
    labels[ahead & (intake < -0.008) & rungs] = _M.DARK_BAR
    if front.bumper == "skid":
        labels[ahead & (z < floor) & (across < 0.62 * half - 0.5 * (floor - z))] = _M.SILVER
    lamp_x = min(0.80, front.intake_width + 0.17) * half
    pocket = np.maximum(np.abs(across - lamp_x) - 0.10, np.abs(z - centre) - 0.055 * s)
    labels[ahead & (pocket < -0.02 * (z - centre > 0))] = plastic
    if front.fog:
        fog = np.hypot((across - lamp_x) / 1.15, z - centre)
        labels[ahead & (fog < 0.044)] = _M.DARK_BAR
        labels[ahead & (fog < 0.036)] = _M.SILVER
        labels[ahead & (fog < 0.020)] = _M.BAR
    crease = (np.abs(z - 0.485 * s) < 0.004) & (across > 0.30) & (across < 0.95 * half)
    labels[ahead & crease & (labels == _M.PAINT)] = _M.SEAM

    _grille(front, half, across, z, lead, ahead, labels)
    _headlamps(front, half, u, z, lead, (behind < 0.8), labels)
    height = max(front.plate_z * lead, body.bumper_low + 0.16)
    _plate(PLATE_SIZES[front.plate], labels, y, z, height, ahead)


def _grille(
    front: FrontDesign,
    half: float,
    across: Array,
    z: Array,
    lead: float,
    ahead: Mask,
    labels: Int64Array,
) -> None:
    """The upper grille by its signed distance: frame, bars and emblem."""
    width, radius = front.grille_width * half, front.grille_height / 2
    if front.lamp not in ("round",):  # it ends where the lamps begin
        width = min(width, front.lamp_inner * half + (0.1 if front.grille == "full" else -0.005))
    v = z - front.grille_z * lead
    slope = {"trapezoid": 0.35, "hexagon": 0.0, "full": -0.12}.get(front.grille, 0.0)
    side = across - width - slope * v
    if front.grille == "hexagon":
        side = across - width + 0.42 * np.abs(v - 0.3 * radius)
    edge = np.maximum(side / np.hypot(1.0, slope), np.abs(v) - radius)
    if front.grille != "none":
        frame = {"chrome": _M.BAR, "dark": _M.DARK_BAR, "painted": _M.PAINT}[front.frame]
        labels[ahead & (edge < 0)] = frame
        inside = ahead & (edge < (-0.006 if front.grille == "bar" else -0.014))
        labels[inside] = _M.GRILLE
        bar = _M.BAR if front.frame == "chrome" and front.bars != "mesh" else _M.DARK_BAR
        pitch = 0.05 if front.grille != "full" else 0.065
        rows, columns = np.abs(v / pitch % 1 - 0.5), np.abs(across / pitch % 1 - 0.5)
        if front.bars == "mesh":
            stripes = (np.abs((across + 1.4 * v) / 0.045 % 1 - 0.5) < 0.15) | (
                np.abs((across - 1.4 * v) / 0.045 % 1 - 0.5) < 0.15
            )
        else:
            stripes = (rows if front.bars == "horizontal" else columns) < 0.15
        labels[inside & (edge < -0.018) & stripes] = bar
    middle = front.grille_z * lead + (0.35 * radius if front.grille in ("hexagon", "full") else 0)
    emblem = np.hypot(across / 1.2, z - middle)
    for size, material in ((0.050, _M.BAR), (0.041, _M.GRILLE), (0.022, _M.BAR)):
        labels[ahead & (emblem < size)] = material


def _headlamps(
    front: FrontDesign,
    half: float,
    u: Array,
    z: Array,
    lead: float,
    where: Mask,
    labels: Int64Array,
) -> None:
    """Headlamps around the corners by signed distances; `u` runs from the middle around them."""
    inner, outer = front.lamp_inner * half, half + front.lamp_wrap
    radius, long = front.lamp_height / 2, outer - inner
    t = (u - inner) / long
    base = front.lamp_z * lead
    v = z - base - front.lamp_slant * lead * t
    near = np.flatnonzero(where & (t > -0.2) & (t < 1.2) & (z > base - 0.35) & (z < base + 0.35))
    t, v, u, height, part = t[near], v[near], u[near], z[near] - base, labels[near]
    ends = np.minimum(t, 1 - t) * long
    clear, housing = _M.LAMP, (_M.LAMP_FRAME if front.lamp_dark else _M.LAMP)
    if front.lamp == "round":
        centre = inner + radius
        inside = radius - np.hypot(u - centre, height)
        rings = [(centre, 0.0, 0.62 * radius)]
    elif front.lamp == "rectangle":
        inside = np.minimum(radius - np.abs(v), ends)
        rings = [(inner + 0.36 * long, 0.0, 0.85 * radius)]
    elif front.lamp == "tall":  # a low inner corner, swept up the wing
        rise = np.clip(t / 0.85, 0.0, 1.0)
        top = radius * (0.1 + 0.9 * rise * rise) + front.lamp_slant * lead * rise
        bottom = -radius * (0.9 - 0.9 * np.clip(t - 0.4, 0.0, 1.0) / 0.6)
        inside = np.minimum(np.minimum(top - height, height - bottom), ends)
        v = height - bottom - radius
        rings = [
            (inner + 0.28 * long, -0.35 * radius, 0.5 * radius),
            (inner + 0.52 * long, -0.25 * radius, 0.6 * radius),
        ]
    elif front.lamp == "split":
        low = height + 0.20 * lead
        inside = np.maximum(
            np.minimum(radius - np.abs(v), ends),
            np.minimum(0.075 - np.abs(low), np.minimum(u - inner - 0.07, half + 0.04 - u)),
        )
        rings = [(inner + 0.15, -0.20 * lead, 0.05), (inner + 0.27, -0.20 * lead, 0.05)]
    else:
        thin = front.lamp == "slit"
        ends_in = np.sqrt(np.clip(t / (0.10 if not thin else 0.04), 0, 1))
        taper = ends_in * (1 - (0.45 if not thin else 0.35) * np.clip(t - 0.45, 0, 1) / 0.55)
        inside = np.minimum(radius * taper - np.abs(v), ends)
        rings = [(inner + 0.22 * long, 0.0, 0.8 * radius), (inner + 0.46 * long, 0.0, 0.8 * radius)]
    part[inside > 0] = _M.LAMP_FRAME
    part[inside > 0.009] = housing
    for centre, above, size in rings:
        line = front.lamp_slant * lead * (centre - inner) / long if front.lamp != "round" else 0.0
        ring = np.hypot(u - centre, height - above - line * (front.lamp != "split"))
        for share, material in (
            (1.0, _M.LAMP_FRAME),
            (0.86, clear),
            (0.62, _M.LAMP_FRAME),
            (0.52, _M.LAMP_CORE),
        ):
            part[(inside > 0.009) & (ring < share * size)] = material
    # running light: a line along the lower edge, or all of a split lamp's upper line
    if front.lamp == "split":
        part[(inside > 0.008) & (np.abs(v) < radius)] = _M.LAMP_CORE
    elif front.lamp_dark and front.lamp != "round":
        part[(inside > 0.010) & (inside < 0.024) & (v < 0)] = _M.LAMP_CORE
    if front.amber and front.lamp != "split":
        part[(inside > 0.012) & (t > 0.76) & (t < 0.95)] = _M.AMBER
    labels[near] = part


def _rear(
    body: TemplateBody, points: Array, normals: Array, panels: BodyPanels, labels: Int64Array
) -> None:
    H, half = body.height, body.width / 2
    rear, front, side = body.design.rear, body.design.front, body.design.side
    x, y, z = points.T
    ahead, across = x + body.length / 2, np.abs(y)
    behind = (normals[:, 0] < -0.25) & (ahead < 0.6)
    bumper = max(rear.bumper_z * H, body.bumper_low + 0.16)
    apron = np.clip(rear.apron_z * H, body.bumper_low + 0.03, bumper - 0.06)

    # tailgate and bumper
    gate = behind & (across < 0.80 * half) & (z > bumper) & (panels.roof < -0.02)
    labels[gate & (np.abs(across - 0.785 * half) < _LINE)] = _M.SEAM
    labels[behind & (np.abs(z - bumper) < _LINE)] = _M.SEAM
    if front.bumper == "black" and side.cladding > 0.03:
        apron = 0.9 * bumper
    labels[behind & (z < apron)] = _M.TRIM
    if front.bumper == "skid":
        skid = (z < 0.75 * apron) & (across < 0.5 * half)
        labels[behind & skid] = _M.SILVER
    mark = (np.abs(z - apron - 0.03) < 0.016) & (np.abs(across - 0.74 * half) < 0.09)
    labels[behind & mark] = _M.REFLECTOR
    pipe = np.hypot((across - 0.62 * half) / 1.4, z - max(0.72 * apron, body.bumper_low + 0.05))
    shown = {"none": y > 9.0, "single": y > 0, "double": across > 0}[rear.exhaust]
    labels[behind & shown & (pipe < 0.038)] = _M.CHROME
    labels[behind & shown & (pipe < 0.028)] = _M.DARK

    # number plate in a recess below a handle strip
    size = PLATE_SIZES[front.plate]
    height = max(rear.plate_z * H, body.bumper_low + 0.16)
    if abs(height - bumper) < size[1] / 2 + 0.03:  # on one side of the bumper's edge
        height = bumper + np.copysign(size[1] / 2 + 0.03, height - bumper)
    recess = np.maximum(across - size[0] / 2 - 0.075, np.abs(z - height) - size[1] / 2 - 0.03)
    labels[behind & (np.abs(recess) < 0.005)] = _M.SEAM
    strip = behind & (across < 0.33) & (np.abs(z - height - size[1] / 2 - 0.042) < 0.012)
    if height > bumper:
        labels[strip] = _M.CHROME if rear.chrome else _M.SEAM
        emblem = np.hypot(across / 1.2, z - height - size[1] / 2 - 0.11)
        labels[behind & (emblem < 0.038)] = _M.CHROME
    _tail_lamps(body, points, panels, behind, labels)
    _plate(size, labels, -y, z, height, behind)
    third = behind & (across < 0.17) & (panels.roof > -0.085) & (panels.roof < -0.06)
    labels[third] = _M.RED_DARK


def _tail_lamps(
    body: TemplateBody, points: Array, panels: BodyPanels, behind: Mask, labels: Int64Array
) -> None:
    """Tail lamps by signed distances: frame, lights, reversing light, indicator."""
    rear, half = body.design.rear, body.width / 2
    x, _, z = points.T
    low, high = rear.lamp_low * body.height, rear.lamp_high * body.height
    inner, outer = rear.lamp_inner * half, half + rear.lamp_wrap
    # from the middle around the corners, also where the body narrows towards the roof
    edge = np.minimum(panels.side, np.maximum(panels.side_window, -half))
    u = half + np.maximum(edge, -half) + _BENT * (x + body.length / 2)
    tall = max(high - low, 0.01)
    t, s = (z - low) / tall, (u - inner) / (outer - inner)
    if rear.lamp == "block":  # cut at an angle towards the gate
        side = u - inner - 0.10 * np.abs(t - 0.35)
    elif rear.lamp == "upright":
        side = u - inner - 0.05 * np.clip(t - 0.45, 0, 1)
    else:
        side = u - inner - 0.25 * (high - z)
    lens = np.minimum.reduce(
        [side, outer - u - 0.25 * np.abs(t - 0.6) * rear.lamp_wrap, z - low, high - z]
    )
    near = np.flatnonzero((lens > 0) | ((rear.lamp == "strip") & behind & (t > 0) & (t < 1)))
    lens, t, s, u, z, part = lens[near], t[near], s[near], u[near], z[near], labels[near]
    if rear.lamp == "strip":
        part[np.abs(t - 0.62) * tall < 0.030] = _M.RED_FRAME
        part[np.abs(t - 0.62) * tall < 0.016] = _M.RED_CORE
    part[lens > 0] = _M.RED_FRAME
    part[lens > 0.008] = _M.RED
    band = lens > 0.014
    turn = {"red": _M.RED_DARK, "clear": _M.REVERSE, "amber": _M.TURN}[rear.indicator]
    if rear.lamp == "upright":
        part[band & (t > 0.18) & (t < 0.34)] = _M.REVERSE
        part[band & (t > 0.36) & (t < 0.52)] = turn
        part[band & (t > 0.60) & (t < 0.92) & (lens > 0.022)] = _M.RED_CORE
    elif rear.lamp == "block":
        part[band & (t < 0.36) & (s < 0.42)] = _M.REVERSE
        part[band & (t < 0.36) & (s > 0.45)] = turn
        part[band & (t > 0.42) & (lens > 0.03)] = _M.RED_DARK
        part[band & (t > 0.45) & (lens > 0.018) & (lens < 0.03)] = _M.RED_CORE
    else:
        part[band & (t < 0.40)] = _M.RED_DARK
        part[band & (t < 0.40) & (s > 0.10) & (s < 0.38)] = _M.REVERSE
        part[band & (t < 0.40) & (s > 0.40) & (s < 0.66)] = turn
        part[band & (np.abs(t - 0.68) * tall < 0.012)] = _M.RED_CORE
    labels[near] = part


def _sides(
    body: TemplateBody, points: Array, normals: Array, panels: BodyPanels, labels: Int64Array
) -> None:
    p, H, side = body.design.proportions, body.height, body.design.side
    x, _, z = points.T
    flat = np.abs(normals[:, 1]) > 0.5
    sill = body.clearance + 0.035 * H + 1.2 * side.cladding
    doors = flat & (z > sill + 0.015)
    # shut lines
    front_edge, wheel = body.x_at(p.cowl_x + 0.045), body.axles[1]
    count = {"front": 1, "quarter": 1, "row": 0}.get(side.panes, 2)
    edges = [front_edge, body.x_at(side.pillar_b_x), body.x_at(side.pillar_c_x)][: count + 1]
    for edge in edges if count else []:
        labels[doors & (np.abs(x - edge) < _LINE) & (z < p.cowl_z * H + 0.35)] = _M.SEAM
    arch = np.min([np.hypot(x - a, z - body.wheel_radius) for a in body.axles], axis=0)
    if count > 1:  # the last door's edge follows the wheel arch
        after = np.hypot(x - wheel, z - body.wheel_radius) - body.arch_radius - 0.07
        labels[doors & (np.abs(after) < _LINE) & (x > wheel) & (x > edges[-1])] = _M.SEAM
    span = flat & (x < edges[0]) & (x > edges[-1])
    if count:
        labels[span & (np.abs(z - sill - 0.015) < _LINE)] = _M.SEAM
    if side.rub_strip:
        strip = flat & (np.abs(x) < 0.28 * body.length) if count else span
        labels[strip & (np.abs(z - 0.40 * H) < 0.022)] = _M.TRIM
    if side.sliding:
        rail = flat & (x < edges[-1]) & (x > -0.44 * body.length)
        labels[rail & (np.abs(z - body.shoulder_z(x) + 0.16) < 0.009)] = _M.SEAM
    grip_material = {"painted": _M.HANDLE, "black": _M.TRIM, "chrome": _M.CHROME}[side.handles]
    for number, edge in enumerate(edges[1:]):
        # a sliding door is opened at its front edge
        start = edges[1] - 0.22 if side.sliding and number == 1 else edge + 0.05
        grip = flat & (x > start) & (x < start + 0.17)
        height = body.shoulder_z(x) - 0.115
        labels[grip & (np.abs(z - height) < 0.014)] = grip_material
        labels[grip & (np.abs(z - height + 0.022) < 0.007)] = _M.SEAM
    # black plastic below and around the arches
    labels[flat & (z < sill)] = _M.TRIM
    if side.cladding > 0.015:
        labels[(arch < body.arch_radius + side.cladding) & (z < p.cowl_z * H)] = _M.TRIM
        labels[(z < sill) & (panels.lower < 0.02)] = _M.TRIM


def _glass(
    body: TemplateBody, points: Array, normals: Array, panels: BodyPanels, labels: Int64Array
) -> None:
    """Windows: the interior of each greenhouse panel, framed in black; roof and rails."""
    p, side, rear = body.design.proportions, body.design.side, body.design.rear
    x, y, _ = points.T
    scale = body.width / 1.75
    edge = 0.075 * scale
    ends = np.maximum(panels.windscreen, panels.rear_window)
    on_side = (panels.side_window > ends) & (panels.side_window > panels.roof)
    on_end = ~on_side & (ends > panels.roof)
    screen = on_end & (panels.windscreen > panels.rear_window)
    back = on_end & ~screen
    on_roof = ~on_side & ~on_end
    if side.black_roof:
        labels[on_roof | (panels.roof > -0.03)] = _M.GLOSS_BLACK
    if side.rails != "none":
        along = (x < body.x_at(p.roof_front_x + 0.05)) & (x > body.x_at(p.roof_rear_x - 0.02))
        rail = on_roof & along & (np.abs(panels.side_window + 0.085 * scale) < 0.016)
        labels[rail] = _M.TRIM if side.rails == "black" else _M.SILVER

    margin = np.minimum.reduce(
        [-panels.side_window - edge, -panels.roof - 0.6 * edge, panels.shoulder - 0.03]
    )
    labels[screen & (margin > -0.016)] = _M.GLOSS_BLACK
    labels[screen & (margin > 0)] = _M.SCREEN
    # interior mirror and resting wipers
    hang = (np.abs(y) < 0.10) & (np.abs(-panels.roof - 0.13) < 0.028)
    labels[screen & hang] = _M.TRIM
    for offset in (-0.38, 0.10):
        wiper = np.abs(panels.shoulder - 0.045 - 0.06 * (y - offset)) < 0.008
        labels[screen & wiper & (y > offset - 0.1) & (y < offset + 0.42)] = _M.TRIM

    inset = edge + (1 - rear.window_width) * body.width / 2
    under = 0.10 if rear.spoiler else 0.6 * edge
    margin = np.minimum.reduce(
        [
            -panels.side_window - inset,
            -panels.roof - under,
            panels.shoulder - 0.03 - rear.window_low,
        ]
    )
    if body.design.rear.window_width > 0.62:
        labels[back & (margin > -0.014)] = _M.GLOSS_BLACK
        labels[back & (margin > 0)] = _M.DARK_GLASS if side.dark_glass else _M.GLASS
        wiper = np.abs(panels.shoulder - 0.07 - rear.window_low - 0.15 * np.abs(y)) < 0.008
        if p.tail_x > 0.93 and p.tail_x - p.roof_rear_x < 0.2:
            labels[back & wiper & (y > -0.05) & (y < 0.36)] = _M.TRIM
    if rear.spoiler:
        labels[back & (-panels.roof > under - 0.03) & (-panels.roof < under - 0.014)] = _M.SEAM

    last = side.pillar_c_x if side.panes == "three" else side.pillar_b_x
    last = side.pillar_c_x if side.panes == "two" else last
    rise = np.clip((body.x_at(last) - x) / (0.1 * body.length), 0.0, 1.0)
    sill = panels.shoulder - 0.035 - side.kick * body.height * rise * rise * (3 - 2 * rise)
    around = np.minimum.reduce(
        [-panels.windscreen - edge, -panels.rear_window - side.rear_pillar, -panels.roof -
         side.pane_top * scale]
    )  # fmt: skip
    stop = {"front": side.pillar_b_x, "row": 9.0}.get(side.panes, 9.0)
    if side.panes == "two":  # the rear door's pane ends above the wheel
        stop = side.pillar_c_x + 0.075
    around = np.minimum(around, x - body.x_at(stop))
    reach = np.minimum(around, sill)
    labels[on_side & (reach > -0.018)] = _M.GLOSS_BLACK
    if side.frame == "chrome":
        labels[on_side & (reach > -0.018) & (reach < -0.004)] = _M.CHROME
    glass = on_side & (reach > 0)
    places = [side.pillar_b_x, side.pillar_c_x]
    if side.panes == "row":
        places = [side.pillar_b_x + 0.14 * k for k in range(6)]
    pillar = np.min(
        [np.abs(x - body.x_at(place)) - side.pillar_width * (1.0 if k == 0 else 0.6)
         for k, place in enumerate(places)], axis=0)  # fmt: skip
    if not side.black_pillars:
        labels[glass & (pillar < -0.012)] = _M.PAINT
    labels[glass & (pillar > 0)] = _M.GLASS
    if side.dark_glass:
        labels[glass & (pillar > 0) & (x < body.x_at(side.pillar_b_x))] = _M.DARK_GLASS
