"""Buildings of four styles."""

from __future__ import annotations

import numpy as np

from recast.synthetic.scenery.arguments import require_count, require_known, require_size
from recast.synthetic.scenery.industrial import industrial
from recast.synthetic.scenery.offices import office
from recast.synthetic.scenery.suburban import suburban
from recast.synthetic.scenery.urban import urban
from recast.synthetic.surface import Surface

BUILDING_STYLES = ("urban", "suburban", "industrial", "office")

_BUILDERS = {"urban": urban, "suburban": suburban, "industrial": industrial, "office": office}


def building(
    rng: np.random.Generator, width: float, depth: float, style: str, storeys: int | None = None
) -> Surface:
    """A building whose front stands on the plane y = 0 and looks to -y.

    Its walls take up x in [-width/2, width/2] and y in [0, depth]; cornices, balconies, awnings,
    eaves and steps stand out by 1.6 m at most.

    Args:
        rng: chooses everything else.
        width, depth: metres, 4 to 120.
        style: "urban", "suburban", "industrial" or "office".
        storeys: 1 to 20; drawn from the style's usual when None.

    Raises:
        InputError: for impossible sizes and unknown styles.
    """
    require_size("building", "width", width, 4.0, 120.0)
    require_size("building", "depth", depth, 4.0, 120.0)
    require_known("building", "style", style, BUILDING_STYLES)
    if storeys is not None:
        require_count("building", "storeys", storeys, 1, 20)
    return _BUILDERS[style](rng, width, depth, storeys)
