"""Wheels: tyre and rim turned in one piece, spokes pressed out of the disc."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.surface import Surface, corner_normals
from recast.synthetic.vehicles.finishes import ALLOY, STEEL, TYRE
from recast.synthetic.vehicles.fittings import both
from recast.synthetic.vehicles.parameters import VehicleParameters
from recast.synthetic.vehicles.solid import Finish, Solid

Array = NDArray[np.float64]


def wheel(
    radius: float, width: float, rim_share: float, spokes: int, dished: bool = False
) -> Surface:
    """One closed wheel about the origin that turns about y and shows its rim at +y.

    Args:
        radius: of the tyre, metres.
        width: of the tyre.
        rim_share: rim radius over tyre radius.
        spokes: of the rim.
        dished: a steel rim with holes, as heavy vehicles have.
    """
    per_spoke = 6 if spokes == 5 else 4
    count = spokes * per_spoke
    angle = np.arange(count) * 2 * np.pi / count
    rim, half = radius * rim_share, width / 2
    # Rings from the hub outwards, over the tread and back to the axle: (radius, y).
    rings: list[tuple[float, float]] = [
        (0.2 * rim, half - 0.035), (0.34 * rim, half - 0.04), (0.62 * rim, half - 0.03),
        (0.88 * rim, half - 0.02), (0.97 * rim, half - 0.012), (1.03 * rim, half - 0.004),
        (0.5 * (rim + radius), half + 0.002), (0.96 * radius, half - 0.01), (radius, 0.5 * half),
        (radius, -0.5 * half), (0.96 * radius, -half), (0.6 * rim, -half),
    ]  # fmt: skip
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
    points = np.concatenate([np.stack([x, y, z], axis=-1).reshape(-1, 3), ends])
    index = np.arange(len(rings) * count).reshape(len(rings), count)
    after = np.roll(index, -1, axis=1)
    a, b, c, d = index[:-1], after[:-1], after[1:], index[1:]
    body = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2)
    hub, axle = len(points) - 2, len(points) - 1
    cap = np.stack([np.full(count, hub), after[0], index[0]], axis=1)
    back = np.stack([np.full(count, axle), index[-1], after[-1]], axis=1)
    faces = np.concatenate([body.reshape(-1, 3), cap, back])
    ring_of = np.repeat(np.arange(len(rings) - 1), 2 * count)
    ring_of = np.concatenate([ring_of, np.full(count, -1), np.full(count, len(rings))])
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


def steel_wheels(
    p: VehicleParameters, front: list[float], rear: list[float]
) -> list[tuple[str, Surface]]:
    """Wheels of a heavy vehicle on axles at these x; the rear ones are twins."""
    turned = wheel(p.wheel_radius, p.tyre_width, p.rim_share, 8, dished=True)
    side: list[tuple[str, Surface]] = []
    edge = p.width / 2 - p.tyre_width / 2 - 0.04
    for k, x in enumerate([*front, *rear]):
        inset = 0.04 * p.width if x in front and p.kind == "box-truck" else 0.0
        for inner in (False, True) if x in rear else (False,):
            pose = np.eye(4)
            shift = (p.tyre_width + 0.03) if inner else 0.0
            pose[:3, 3] = x, edge - inset - shift, p.wheel_radius
            side.append((f"wheel-{k}{'-inner' if inner else ''}", turned.transformed(pose)))
    return both(side)
