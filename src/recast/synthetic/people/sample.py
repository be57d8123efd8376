"""Random people: sizes and clothes."""

from __future__ import annotations

import numpy as np

from recast.synthetic.people.body import Look, moving_model
from recast.synthetic.people.cyclist import Ride
from recast.synthetic.people.pedestrian import Walk
from recast.synthetic.world import VehicleModel

_SKIN = ((0.6, 0.4, 0.3), (0.48, 0.3, 0.21), (0.32, 0.18, 0.11), (0.16, 0.09, 0.06))
_HAIR = ((0.03, 0.02, 0.015), (0.1, 0.05, 0.02), (0.3, 0.2, 0.08), (0.35, 0.34, 0.33))
_CLOTHES = {
    "red": (0.45, 0.03, 0.03), "blue": (0.04, 0.1, 0.4), "navy": (0.015, 0.025, 0.09),
    "green": (0.05, 0.22, 0.06), "yellow": (0.65, 0.45, 0.04), "white": (0.68, 0.68, 0.66),
    "grey": (0.2, 0.2, 0.21), "black": (0.02, 0.02, 0.02), "beige": (0.45, 0.36, 0.22),
    "purple": (0.2, 0.05, 0.25), "orange": (0.6, 0.18, 0.02),
}  # fmt: skip
_TROUSERS = ("navy", "black", "grey", "beige", "blue", "white")
_SHOES = ("black", "white", "red", "beige")
_CHILDREN, _PACKS = 0.2, 0.35


def sample_pedestrian(rng: np.random.Generator) -> VehicleModel:
    """A random pedestrian; its colour is the name of what is worn above the belt."""
    chance = rng.uniform(size=2)
    height = rng.uniform(1.1, 1.4) if chance[0] < _CHILDREN else rng.uniform(1.55, 1.92)
    name, look = _look(height, rng)
    pack = _CLOTHES[_pick(tuple(_CLOTHES), rng)]
    return moving_model("pedestrian", name, Walk(look, pack if chance[1] < _PACKS else None))


def sample_cyclist(rng: np.random.Generator) -> VehicleModel:
    """A random adult on a bicycle; its colour is the name of what is worn above the belt."""
    name, look = _look(rng.uniform(1.62, 1.86), rng)
    return moving_model("cyclist", name, Ride(look, _CLOTHES[_pick(tuple(_CLOTHES), rng)]))


def _look(height: float, rng: np.random.Generator) -> tuple[str, Look]:
    name = _pick(tuple(_CLOTHES), rng)
    look = Look(
        height=float(height),
        girth=float(rng.uniform(0.85, 1.25) * height / 1.75),
        skin=_SKIN[int(rng.integers(len(_SKIN)))],
        hair=_HAIR[int(rng.integers(len(_HAIR)))],
        top=_CLOTHES[name],
        trousers=_CLOTHES[_pick(_TROUSERS, rng)],
        shoes=_CLOTHES[_pick(_SHOES, rng)],
    )
    return name, look


def _pick(names: tuple[str, ...], rng: np.random.Generator) -> str:
    return names[int(rng.integers(len(names)))]
