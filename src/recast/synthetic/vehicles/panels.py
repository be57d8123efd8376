"""Underbody, wheel wells, door lines and bumper seams."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.vehicles.finishes import CLADDING, SEAM, TRIM, UNDERSIDE, Area, strip, xyz
from recast.synthetic.vehicles.loft import Body
from recast.synthetic.vehicles.parameters import VehicleParameters
from recast.synthetic.vehicles.solid import Solid

Array = NDArray[np.float64]


def underside(solid: Solid, p: VehicleParameters) -> None:
    """Dark floor, and unpainted sills where the vehicle has cladding."""
    sill = p.ground_clearance + (0.13 if p.cladding else 0.045)
    solid.paint(lambda s: s.points[:, 2] - sill, CLADDING if p.cladding else TRIM)
    solid.paint(lambda s: s.coords[:, 2] - 0.025, UNDERSIDE)


def wheel_wells(solid: Solid, body: Body, p: VehicleParameters) -> None:
    """Arches with cladding, opened inwards."""
    inner = p.width / 2 - p.tyre_width - 0.13
    for x, z, radius in body.arches:

        def circle(s: Solid, x: float = x, z: float = z, radius: float = radius) -> Array:
            field = np.hypot(s.points[:, 0] - x, s.points[:, 2] - z) - radius
            return np.maximum(np.maximum(field, s.coords[:, 2] - 0.8), inner - s.points[:, 1])

        if p.cladding:
            solid.paint(lambda s, circle=circle: circle(s) - p.cladding, CLADDING)  # type: ignore[misc]

        def inwards(points: Array) -> Array:
            moved = points.copy()
            # A little depth is kept so that no triangle collapses.
            moved[:, 1] = inner + 0.03 * (points[:, 1] - inner)
            return moved

        solid.push(circle, inwards, UNDERSIDE)


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
        across: where it begins and ends on the other axis.
        half: half its width.
        tilt: metres of x per metre of height.
    """

    def fields(s: Solid) -> Area:
        x, _, z = xyz(s)
        main, other = (x, z) if axis == 0 else (z, x)
        distance = main - at + (tilt * (z - across[0]) if axis == 0 else 0)
        limits = [across[0] - other, other - across[1]]
        return strip(distance, half), [*limits, 0.93 - s.coords[:, 1]]

    solid.paint(fields, SEAM, over=("paint", "plastic"))


def doors(solid: Solid, body: Body, p: VehicleParameters, edges: list[float]) -> None:
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
