"""What the parts of a vehicle are made of, and which part each point of the body belongs to.

A material has a colour, and mirrors more or less of its surroundings. Parts are windows, lamps,
grille, doors and plates.
"""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np

from recast.arrays import Array, Int64Array, Mask

if TYPE_CHECKING:
    from recast.actors.template.body import BodyPanels, TemplateBody
    from recast.actors.template.design import FrontDesign


PLATE_SIZE = (0.52, 0.115)  # European, metres


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


_FINISHES = {
    TemplateMaterial.PAINT: ((0.40, 0.41, 0.43), 1.0, 1.0),  # replaced by the observed paint
    TemplateMaterial.GLASS: ((0.10, 0.11, 0.12), 3.2, 0.0),
    TemplateMaterial.TRIM: ((0.15, 0.15, 0.16), 0.25, 0.0),
    TemplateMaterial.SEAM: (
        (0.06, 0.06, 0.06),
        0.3,
        0.3,
    ),  # shut lines show a little of the body colour
    TemplateMaterial.TYRE: ((0.13, 0.13, 0.135), 0.1, 0.0),
    TemplateMaterial.ALLOY: ((0.66, 0.67, 0.69), 1.2, 0.0),
    TemplateMaterial.CHROME: ((0.72, 0.73, 0.75), 3.0, 0.0),
    TemplateMaterial.LAMP: ((0.62, 0.65, 0.68), 1.5, 0.0),
    TemplateMaterial.LAMP_CORE: ((0.95, 0.96, 0.98), 0.6, 0.0),
    TemplateMaterial.AMBER: ((0.86, 0.45, 0.12), 1.0, 0.0),
    TemplateMaterial.RED: ((0.58, 0.05, 0.05), 1.0, 0.0),
    TemplateMaterial.RED_CORE: ((0.82, 0.12, 0.10), 0.6, 0.0),
    TemplateMaterial.PLATE: ((0.90, 0.90, 0.88), 0.2, 0.0),
    TemplateMaterial.INK: ((0.10, 0.10, 0.11), 0.2, 0.0),
    TemplateMaterial.PLATE_BAND: ((0.10, 0.20, 0.60), 0.2, 0.0),
    TemplateMaterial.DARK: ((0.03, 0.03, 0.03), 0.0, 0.0),
    TemplateMaterial.GRILLE: ((0.09, 0.09, 0.095), 0.3, 0.0),
    TemplateMaterial.HANDLE: ((0.40, 0.41, 0.43), 2.0, 1.0),  # paint too, see `PAINTED`
}
"""Display colour; factor on the Fresnel reflection of a clear coat; share of the body colour."""

SRGB = np.array([_FINISHES[m][0] for m in TemplateMaterial])
"""(materials, 3) display colours."""
GLOSS = np.array([_FINISHES[m][1] for m in TemplateMaterial])
"""(materials,) factor on the Fresnel reflection of a clear coat."""
PAINTED = np.array([_FINISHES[m][2] for m in TemplateMaterial])
"""(materials,) share of the body colour."""
GLASS = np.array([float(m == TemplateMaterial.GLASS) for m in TemplateMaterial])
"""(materials,) 1 for windows."""
RIM = np.array([float(m == TemplateMaterial.ALLOY) for m in TemplateMaterial])
"""(materials,) 1 for the metal of wheels."""


class VehiclePart(IntEnum):
    """What a patch belongs to, as far as its colour tells."""

    PAINT = 0
    GLASS = 1
    DARK = 2
    RED = 3
    CLEAR = 4
    PLATE = 5


_DARK = VehiclePart.DARK
_PARTS = {
    TemplateMaterial.PAINT: VehiclePart.PAINT,
    TemplateMaterial.HANDLE: VehiclePart.PAINT,
    TemplateMaterial.GLASS: VehiclePart.GLASS,
    TemplateMaterial.RED: VehiclePart.RED,
    TemplateMaterial.RED_CORE: VehiclePart.RED,
    TemplateMaterial.AMBER: VehiclePart.RED,
    TemplateMaterial.LAMP: VehiclePart.CLEAR,
    TemplateMaterial.LAMP_CORE: VehiclePart.CLEAR,
    TemplateMaterial.CHROME: VehiclePart.CLEAR,
    TemplateMaterial.PLATE: VehiclePart.PLATE,
    TemplateMaterial.PLATE_BAND: VehiclePart.PLATE,
}
PART_OF_MATERIAL = np.array([_PARTS.get(m, _DARK) for m in TemplateMaterial])
"""(materials,) part of each material."""


def label_body(body: TemplateBody, points: Array, normals: Array) -> Int64Array:
    """Materials (N,) of body surface points (N, 3) with outward normals (N, 3)."""
    panels = body.panels(points)
    labels = np.full(len(points), int(TemplateMaterial.PAINT))
    _sides(body, points, normals, labels)
    _front(body, points, normals, labels)
    _rear(body, points, normals, panels, labels)
    _glass(body, points, panels, labels)
    labels[(normals[:, 2] < -0.75) & (points[:, 2] < 0.3 * body.height)] = TemplateMaterial.DARK
    labels[body.wells(points) < 0.004] = TemplateMaterial.DARK
    return labels


def _plate(labels: Int64Array, y: Array, z: Array, height: float, where: Mask) -> None:
    """A number plate at `height`: frame, white field, blue band and strokes for characters."""
    w, h = PLATE_SIZE
    v = z - height
    labels[where & (np.abs(y) < w / 2 + 0.02) & (np.abs(v) < h / 2 + 0.018)] = TemplateMaterial.TRIM
    field = where & (np.abs(y) < w / 2) & (np.abs(v) < h / 2)
    labels[field] = TemplateMaterial.PLATE
    u = y / (w / 2)
    labels[field & (u < -0.9)] = TemplateMaterial.PLATE_BAND
    glyph = np.abs((u + 1) * 5.2 % 1 - 0.5) < 0.28
    hole = np.abs((u + 1) * 5.2 % 1 - 0.5) < 0.09
    written = (np.abs(u) < 0.84) & (np.abs(u + 0.15) > 0.06) & (np.abs(v) < 0.033)
    labels[field & glyph & written & ~(hole & (np.abs(v) < 0.018))] = TemplateMaterial.INK


def _front(body: TemplateBody, points: Array, normals: Array, labels: Int64Array) -> None:
    p, H, half = body.design.proportions, body.height, body.width / 2
    x, y, z = points.T
    behind = body.length / 2 - x
    ahead = (normals[:, 0] > 0.25) & (behind < 0.5 * half + 0.2) & (z < 1.05 * p.cowl_z * H)
    front = body.design.front
    lead = p.bonnet_z * H
    s = lead / 0.70  # heights scale with the height of the nose

    # bonnet: shut lines beside and ahead
    top = (normals[:, 2] > 0.5) & (z < p.cowl_z * H + 0.03) & (x > body.x_at(p.cowl_x))
    line = 0.80 * half - 0.10 * half * np.clip(1 - behind / (p.cowl_x * body.length), 0, 1)
    labels[top & (np.abs(np.abs(y) - line) < 0.007)] = TemplateMaterial.SEAM
    labels[ahead & (np.abs(z - lead + 0.012) < 0.007) & (np.abs(y) < 0.78 * half)] = (
        TemplateMaterial.SEAM
    )

    # lower bumper: apron, intake, fog lamps
    labels[ahead & (z < 0.225 * s)] = TemplateMaterial.TRIM
    intake = (
        ahead
        & (np.abs(y) < 0.56 * half + 0.3 * (z - 0.26 * s))
        & (np.abs(z - 0.285 * s) < 0.052 * s)
    )
    labels[intake] = TemplateMaterial.GRILLE
    labels[intake & (np.abs((z / s - 0.285) / 0.024 % 1 - 0.5) > 0.36)] = TemplateMaterial.TRIM
    fog = np.hypot((np.abs(y) - 0.73 * half) / 1.35, z - 0.285 * s)
    labels[ahead & (fog < 0.072 * s)] = TemplateMaterial.GRILLE
    labels[ahead & (fog < 0.042 * s)] = TemplateMaterial.LAMP
    labels[ahead & (fog < 0.024 * s)] = TemplateMaterial.LAMP_CORE
    # a crease across the bumper
    crease = (np.abs(z - 0.485 * s) < 0.006) & (np.abs(y) > 0.30) & (np.abs(y) < 0.95 * half)
    labels[ahead & crease] = TemplateMaterial.SEAM

    # grille with chrome frame, bars and emblem
    u = np.abs(y) / (front.grille_width * half)
    v = (z - front.grille_z * lead) / (front.grille_height / 2)
    outline = np.maximum(u + 0.10 * v, np.abs(v))
    labels[ahead & (outline < 1.0) & (np.abs(v) < 1.0)] = TemplateMaterial.CHROME
    inside = ahead & (outline < 0.95) & (np.abs(v) < 0.86)
    labels[inside] = TemplateMaterial.GRILLE
    labels[inside & (np.abs((v + 1) * 2.0 % 1 - 0.5) < 0.085)] = TemplateMaterial.CHROME
    emblem = np.hypot(y, z - front.grille_z * lead)
    labels[ahead & (emblem < 0.052)] = TemplateMaterial.CHROME
    labels[ahead & (emblem < 0.040)] = TemplateMaterial.TRIM
    labels[ahead & (emblem < 0.024)] = TemplateMaterial.CHROME

    around = (normals[:, 0] > 0.02) & (behind < 0.7)
    _headlamps(front, half, np.abs(y) + 0.8 * behind, z, lead, around, labels)
    _plate(labels, y, z, front.plate_z * lead, ahead)


def _headlamps(
    front: FrontDesign,
    half: float,
    u: Array,
    z: Array,
    lead: float,
    where: Mask,
    labels: Int64Array,
) -> None:
    """Almond-shaped headlamps wrapped around the corners; `u` runs from the middle around them."""
    inner, outer = front.lamp_inner * half, half + front.lamp_wrap
    t = (u - inner) / (outer - inner)
    middle = (front.lamp_z + front.lamp_slant * t) * lead
    radius = front.lamp_height / 2
    ends = np.sqrt(np.clip(t / 0.10, 0, 1)) * (1 - 0.45 * np.clip(t - 0.55, 0, 1) / 0.45)
    tall = radius * ends
    v = (z - middle) / np.maximum(tall, 1e-3)
    lens = where & (t > 0) & (t < 1) & (np.abs(v) < 1)
    labels[lens] = TemplateMaterial.GRILLE
    labels[lens & (np.abs(v) < 0.86) & (t > 0.025) & (t < 0.975)] = TemplateMaterial.LAMP
    for centre, size in ((0.24, 0.80), (0.50, 0.86)):
        ring = np.hypot((t - centre) * (outer - inner), z - middle) / radius
        labels[lens & (ring < size)] = TemplateMaterial.GRILLE
        labels[lens & (ring < size - 0.16)] = TemplateMaterial.LAMP
        labels[lens & (ring < size - 0.36)] = TemplateMaterial.LAMP_CORE
    labels[lens & (t > 0.78) & (t < 0.96) & (np.abs(v) < 0.8)] = TemplateMaterial.AMBER


def _rear(
    body: TemplateBody, points: Array, normals: Array, panels: BodyPanels, labels: Int64Array
) -> None:
    H, half = body.height, body.width / 2
    x, y, z = points.T
    ahead = x + body.length / 2
    behind = (normals[:, 0] < -0.25) & (ahead < 0.6)
    low = body.design.rear.lamp_low * H
    bumper = min(0.36 * H, 0.62)

    # tailgate and bumper
    gate = behind & (np.abs(y) < 0.80 * half) & (z > bumper) & (panels.roof < -0.02)
    labels[gate & (np.abs(np.abs(y) - 0.785 * half) < 0.007)] = TemplateMaterial.SEAM
    labels[behind & (np.abs(z - bumper) < 0.007)] = TemplateMaterial.SEAM
    labels[behind & (z < 0.60 * bumper)] = TemplateMaterial.TRIM
    labels[
        behind & (np.abs(z - 0.75 * bumper) < 0.018) & (np.abs(np.abs(y) - 0.72 * half) < 0.1)
    ] = TemplateMaterial.RED
    pipe = np.hypot(np.abs(y) - 0.62 * half, z - 0.5 * bumper)
    labels[behind & (y > 0) & (pipe < 0.042)] = TemplateMaterial.CHROME
    labels[behind & (y > 0) & (pipe < 0.030)] = TemplateMaterial.DARK

    # number plate in a recess below a handle strip
    height = (
        max(0.5 * (bumper + low) + 0.05, bumper + 0.11) if low - bumper < 0.3 else bumper + 0.16
    )
    recess = behind & (np.abs(y) < 0.36) & (np.abs(z - height) < 0.085)
    labels[recess & ~((np.abs(y) < 0.345) & (np.abs(z - height) < 0.075))] = TemplateMaterial.SEAM
    strip = behind & (np.abs(y) < 0.30) & (np.abs(z - height - 0.10) < 0.012)
    labels[strip] = TemplateMaterial.CHROME
    _plate(labels, -y, z, height, behind)
    emblem = np.hypot(y, z - height - 0.165)
    labels[behind & (emblem < 0.04)] = TemplateMaterial.CHROME

    _tail_lamps(body, np.abs(y) + 0.8 * ahead, z, (normals[:, 0] < -0.02) & (ahead < 0.7), labels)
    third = behind & (np.abs(y) < 0.17) & (panels.roof > -0.10) & (panels.roof < -0.055)
    labels[third] = TemplateMaterial.RED


def _tail_lamps(body: TemplateBody, u: Array, z: Array, where: Mask, labels: Int64Array) -> None:
    rear, half = body.design.rear, body.width / 2
    low, high = rear.lamp_low * body.height, rear.lamp_high * body.height
    inner, outer = rear.lamp_inner * half, half + rear.lamp_wrap
    s, t = (u - inner) / (outer - inner), (z - low) / (high - low)
    lens = where & (s > 0) & (s < 1) & (t > 0) & (t < 1)
    labels[lens] = TemplateMaterial.SEAM
    lens &= (s > 0.03) & (s < 0.97) & (t > 0.06) & (t < 0.94)
    labels[lens] = TemplateMaterial.RED
    labels[lens & (t > 0.10) & (t < 0.30) & (s < 0.55)] = TemplateMaterial.LAMP
    labels[lens & (t > 0.10) & (t < 0.30) & (s > 0.55)] = TemplateMaterial.AMBER
    core = lens & (t > 0.46) & (t < 0.82) & (np.abs(s - 0.42) < 0.26)
    labels[core] = TemplateMaterial.RED_CORE


def _sides(body: TemplateBody, points: Array, normals: Array, labels: Int64Array) -> None:
    p, H = body.design.proportions, body.height
    x, _, z = points.T
    side = np.abs(normals[:, 1]) > 0.5
    sill = body.clearance + 0.07 * H
    labels[side & (z < sill)] = TemplateMaterial.TRIM
    doors = side & (z > sill + 0.015)
    front_edge, wheel = body.x_at(p.cowl_x + 0.045), body.axles[1]
    edges = [front_edge, *(body.x_at(f) for f in p.side_pillars_x[:2])]
    for edge in edges:
        labels[doors & (np.abs(x - edge) < 0.007) & (z < p.cowl_z * H + 0.35)] = (
            TemplateMaterial.SEAM
        )
    # the last door's edge follows the wheel arch
    arch = np.abs(np.hypot(x - wheel, z - body.wheel_radius) - body.arch_radius - 0.06)
    if len(p.side_pillars_x) > 1:
        labels[doors & (arch < 0.007) & (x > wheel) & (x > edges[-1])] = TemplateMaterial.SEAM
    span = side & (x < edges[0]) & (x > edges[-1])
    labels[span & (np.abs(z - sill - 0.015) < 0.008)] = TemplateMaterial.SEAM
    labels[span & (np.abs(z - 0.40 * H) < 0.014)] = TemplateMaterial.TRIM
    for edge in edges[1:]:
        grip = side & (x > edge + 0.05) & (x < edge + 0.24)
        height = body.shoulder_z(x) - 0.115
        labels[grip & (np.abs(z - height) < 0.017)] = TemplateMaterial.HANDLE
        labels[grip & (np.abs(z - height + 0.026) < 0.009)] = TemplateMaterial.SEAM


def _glass(body: TemplateBody, points: Array, panels: BodyPanels, labels: Int64Array) -> None:
    """Windows: the interior of each greenhouse panel, framed in black."""
    p = body.design.proportions
    x, y, _ = points.T
    cab = panels.lower > 0.01  # on the greenhouse, not on the body below
    edge = 0.075 * body.width / 1.75

    screen = cab & (panels.windscreen > np.maximum(panels.side_window, panels.roof))
    rear = cab & (panels.rear_window > np.maximum(panels.side_window, panels.roof))
    side = (
        cab
        & (panels.side_window > np.maximum(panels.windscreen, panels.rear_window))
        & (panels.side_window > panels.roof)
    )
    margin = np.minimum.reduce(
        [-panels.side_window - edge, -panels.roof - 0.6 * edge, panels.shoulder - 0.03]
    )
    side_margin = np.minimum.reduce(
        [
            -panels.windscreen - edge,
            -panels.rear_window - 1.6 * edge,
            -panels.roof - edge,
            panels.shoulder - 0.035,
        ]
    )
    labels[(screen | rear) & (margin > -0.022)] = TemplateMaterial.TRIM
    labels[(screen | rear) & (margin > 0)] = TemplateMaterial.GLASS
    # interior mirror and resting wipers
    sill = panels.shoulder
    labels[screen & (np.abs(y) < 0.11) & (np.abs(-panels.roof - 0.15) < 0.03)] = (
        TemplateMaterial.TRIM
    )
    for offset in (-0.38, 0.10):
        wiper = np.abs(sill - 0.045 - 0.06 * (y - offset)) < 0.009
        labels[screen & wiper & (y > offset - 0.1) & (y < offset + 0.42)] = TemplateMaterial.TRIM
    pane = side & (side_margin > -0.02)
    if not p.rear_windows:
        pane &= x > body.x_at(p.side_pillars_x[0])
    labels[pane] = TemplateMaterial.TRIM
    glass = pane & (side_margin > 0)
    for fraction, width in zip(p.side_pillars_x, (0.055, 0.035, *[0.03] * 8), strict=False):
        glass &= np.abs(x - body.x_at(fraction)) > width
    labels[glass] = TemplateMaterial.GLASS
