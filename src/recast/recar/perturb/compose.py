"""Drawing perturbations and putting them one on the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recast.errors import InputError
from recast.recar.perturb.config import PerturbationConfig
from recast.recar.perturb.extent import find_object
from recast.recar.perturb.kind import Kind, Picture
from recast.trellis import check_crop
from recast.trellis.conditioning.read import OPAQUE

_TRIES = 16
_ROOM = 1.6
"""Side of the square that is worked on, over the extent; `crop_to_object` looks at 1.2."""


@dataclass(frozen=True)
class Perturbed:
    """A picture and what was done to it.

    Attributes:
        rgba: (H, W, 4) uint8, straight alpha, of the size of the picture that was given.
        applied: names and severities in the order of application; empty for a clean picture.
    """

    rgba: Picture
    applied: tuple[tuple[str, float], ...]


def perturb(rgba: Picture, config: PerturbationConfig, rng: np.random.Generator) -> Perturbed:
    """Leave a picture clean with probability rho_clean, or spoil it by one to three kinds.

    Everything farther from the object than a third of its extent becomes transparent where the
    picture is spoilt. A draw whose result `check_crop` refuses, or that hides too much, is drawn
    again; after 16 of them the picture stays clean.

    Args:
        rgba: (H, W, 4) uint8, straight alpha.
        config: what is drawn.
        rng: of everything random.

    Raises:
        InputError: `rgba` itself is refused by `recast.trellis.check_crop`.
    """
    check_crop(rgba, "picture to perturb")
    if rng.uniform() < config.rho_clean:
        return Perturbed(rgba, ())
    rows, columns = _window(rgba)
    window = np.ascontiguousarray(rgba[rows, columns])
    for _ in range(_TRIES):
        drawn = draw(config, rng)
        spoilt = compose(window, drawn, rng)
        if spoilt is None or _opaque(spoilt) < config.least_visible * _opaque(window):
            continue
        out = np.zeros_like(rgba)
        out[rows, columns] = spoilt
        if _passes(out):
            return Perturbed(out, tuple((kind.name, severity) for kind, severity in drawn))
    return Perturbed(rgba, ())


def draw(config: PerturbationConfig, rng: np.random.Generator) -> tuple[tuple[Kind, float], ...]:
    """Different kinds and their severities, in the order in which a picture comes about."""
    kinds = [kind for kind in config.kinds() if kind.weight > 0]
    weights = np.array([kind.weight for kind in kinds])
    low, high = config.composed
    count = min(int(rng.integers(low, high + 1)), len(kinds))
    chosen = np.sort(rng.choice(len(kinds), count, replace=False, p=weights / weights.sum()))
    return tuple((kinds[i], float(rng.uniform(*kinds[i].severity))) for i in chosen)


def compose(
    rgba: Picture, drawn: tuple[tuple[Kind, float], ...], rng: np.random.Generator
) -> Picture | None:
    """Apply kinds one after the other; None where nothing of the object is left."""
    for kind, severity in drawn:
        rgba = kind(rgba, severity, rng)
        if not _opaque(rgba):
            return None
    return rgba


def _window(rgba: Picture) -> tuple[slice, slice]:
    """Rows and columns of a square around the object, as far as the picture has it."""
    box = find_object(rgba)
    half = int(np.ceil(_ROOM * box.extent / 2))
    row, column = box.top + box.height // 2, box.left + box.width // 2
    return slice(max(row - half, 0), row + half), slice(max(column - half, 0), column + half)


def _opaque(rgba: Picture) -> int:
    return int(np.count_nonzero(rgba[..., 3] > OPAQUE))


def _passes(rgba: Picture) -> bool:
    try:
        check_crop(rgba, "perturbed picture")
    except InputError:
        return False
    return True
