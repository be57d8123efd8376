"""What the parts of a vehicle are made of: colour and how much of the surroundings they mirror."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Material(IntEnum):
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


_SRGB = {
    Material.PAINT: (0.40, 0.41, 0.43),  # replaced by the observed paint
    Material.GLASS: (0.10, 0.11, 0.12),
    Material.TRIM: (0.15, 0.15, 0.16),
    Material.SEAM: (0.06, 0.06, 0.06),
    Material.TYRE: (0.13, 0.13, 0.135),
    Material.ALLOY: (0.66, 0.67, 0.69),
    Material.CHROME: (0.72, 0.73, 0.75),
    Material.LAMP: (0.62, 0.65, 0.68),
    Material.LAMP_CORE: (0.95, 0.96, 0.98),
    Material.AMBER: (0.86, 0.45, 0.12),
    Material.RED: (0.58, 0.05, 0.05),
    Material.RED_CORE: (0.82, 0.12, 0.10),
    Material.PLATE: (0.90, 0.90, 0.88),
    Material.INK: (0.10, 0.10, 0.11),
    Material.PLATE_BAND: (0.10, 0.20, 0.60),
    Material.DARK: (0.03, 0.03, 0.03),
    Material.GRILLE: (0.09, 0.09, 0.095),
    Material.HANDLE: (0.40, 0.41, 0.43),  # paint too, see `PAINTED`
}
# Factor on the Fresnel reflection of a clear coat; 0 for rubber and recesses.
_GLOSS = {
    Material.PAINT: 1.0, Material.GLASS: 3.2, Material.TRIM: 0.25, Material.SEAM: 0.3,
    Material.TYRE: 0.1, Material.ALLOY: 1.2, Material.CHROME: 3.0, Material.LAMP: 1.5,
    Material.LAMP_CORE: 0.6, Material.AMBER: 1.0, Material.RED: 1.0, Material.RED_CORE: 0.6,
    Material.PLATE: 0.2, Material.INK: 0.2, Material.PLATE_BAND: 0.2, Material.DARK: 0.0,
    Material.GRILLE: 0.3, Material.HANDLE: 2.0,
}  # fmt: skip

SRGB = np.array([_SRGB[m] for m in Material])
"""(materials, 3) display colours."""
GLOSS = np.array([_GLOSS[m] for m in Material])
"""(materials,)"""


_PAINTED = {Material.PAINT: 1.0, Material.HANDLE: 1.0, Material.SEAM: 0.3}
PAINTED = np.array([_PAINTED.get(m, 0.0) for m in Material])
"""(materials,) share of the body colour; shut lines show a little of it."""
GLASS = np.array([float(m == Material.GLASS) for m in Material])
"""(materials,) 1 for windows."""
RIM = np.array([float(m == Material.ALLOY) for m in Material])
"""(materials,) 1 for the metal of wheels."""
