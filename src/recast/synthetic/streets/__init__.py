"""Nine kinds of street, by name, each drawn anew from a seed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from recast.core.errors import InputError
from recast.synthetic.streets.outskirts import (
    arterial_median,
    industrial,
    roundabout_approach,
    underpass,
)
from recast.synthetic.streets.site import EGO_START, Site
from recast.synthetic.streets.town import (
    parked_street,
    rural_two_lane,
    signalled_intersection,
    suburban_curve,
    urban_straight,
)
from recast.synthetic.world import Street

__all__ = ["EGO_START", "SCENES", "make_street"]

_KINDS: dict[str, tuple[Callable[[Generator, float], Site], tuple[float, float]]] = {
    "urban-straight": (urban_straight, (35.0, 60.0)),
    "suburban-curve": (suburban_curve, (22.0, 55.0)),
    "signalled-intersection": (signalled_intersection, (30.0, 60.0)),
    "rural-two-lane": (rural_two_lane, (18.0, 50.0)),
    "arterial-median": (arterial_median, (25.0, 60.0)),
    "parked-street": (parked_street, (38.0, 62.0)),
    "roundabout-approach": (roundabout_approach, (22.0, 58.0)),
    "industrial": (industrial, (25.0, 60.0)),
    "underpass": (underpass, (25.0, 55.0)),
}
"""By name: what builds the scene, and between which degrees its sun stands."""

SCENES: tuple[str, ...] = tuple(_KINDS)
"""Names of all scenes."""

MIN_LENGTH, MAX_LENGTH = 20.0, 350.0


def make_street(name: str, rng: Generator, length: float) -> Street:
    """A street of the kind `name`.

    The ego drives `length` metres along the lanes of `Street.ego_route`, from `EGO_START` metres
    after their beginning; they go on for at least 120 m more.

    Args:
        name: one of `SCENES`.
        rng: source of everything that differs between two streets of a kind.
        length: metres.

    Raises:
        InputError: a name that is not known, or a length out of range.
    """
    if name not in _KINDS:
        raise InputError("scene", "name", f"'{name}' is unknown", f"use one of {', '.join(SCENES)}")
    if not np.isfinite(length) or not MIN_LENGTH <= length <= MAX_LENGTH:
        mend = f"give metres from {MIN_LENGTH:g} to {MAX_LENGTH:g}"
        raise InputError("scene", "length", f"{length} m is not possible", mend)
    build, elevation = _KINDS[name]
    return build(rng, length).finish(name, elevation)
