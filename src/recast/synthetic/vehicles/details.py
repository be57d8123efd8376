"""Closed parts set into the front and the rear: plates, projectors, badges, pipes."""

from __future__ import annotations

import numpy as np

from recast.synthetic.surface import Surface
from recast.synthetic.vehicles.finishes import CHROME, DISPLAY, INK, PLATE, REAR_PLATE, SEAM, TRIM
from recast.synthetic.vehicles.fittings import grid_block, pebble
from recast.synthetic.vehicles.solid import Finish, Solid

Parts = list[tuple[str, Surface]]


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
    lens = pebble((x + sign * (proud - 0.012), y, z), (0.024, 2 * radius, 2 * radius), finish, 2.4,
                  (4, 10))  # fmt: skip
    return lens.surface()


def badge(solid: Solid, z: float, sign: float, radius: float = 0.05) -> Surface:
    """The maker's sign in the middle."""
    return disc(solid, 0.0, z, sign, radius, CHROME, 0.004)


def number_plate(solid: Solid, low: float, sign: float, wide: float = 0.52) -> Surface:
    """A plate in the middle of an end, its lower edge at `low`, with seven characters."""
    high = low + 0.11
    edges = np.linspace(-0.43, 0.43, 7) * wide
    columns = np.concatenate([[-wide / 2], np.sort(np.concatenate([edges - 0.016, edges + 0.016])),
                              [wide / 2]])  # fmt: skip
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
