"""Drawing perturbations and putting them one on the other."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from recast.errors import InputError
from recast.recar.perturb.config import PerturbationConfig
from recast.recar.perturb.extent import find_object, shrinking
from recast.recar.perturb.kind import Kind, Picture
from recast.recar.perturb.premultiplied import premultiplied, straight
from recast.trellis import check_crop
from recast.trellis.conditioning.read import OPAQUE

_TRIES = 16
_ROOM = 0.25
"""Kept on each side of the object, over the extent: no kind makes it larger by more."""


@dataclass(frozen=True)
class Perturbed:
    """A picture and what was done to it.

    Attributes:
        rgba: (H', W', 4) uint8, straight alpha: the picture that was given where it stays clean,
            else the object's surroundings.
        applied: names and severities in the order of application; empty for a clean picture.
    """

    rgba: Picture
    applied: tuple[tuple[str, float], ...]


def perturb(rgba: Picture, config: PerturbationConfig, rng: np.random.Generator) -> Perturbed:
    """Leave a picture clean with probability rho_clean, or spoil it by one to three kinds.

    A spoilt picture is cut to the object's surroundings, and brought down to `finest` pixels of
    extent where it is larger. A draw whose result `check_crop` refuses, or that hides too much, is
    drawn again; after 16 of them the picture stays clean.

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
    window = surroundings(rgba, config.finest)
    for _ in range(_TRIES):
        drawn = draw(config, rng)
        spoilt = compose(window, drawn, rng)
        if spoilt is None or _opaque(spoilt) < config.least_visible * _opaque(window):
            continue
        if _passes(spoilt):
            return Perturbed(spoilt, tuple((kind.name, severity) for kind, severity in drawn))
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


def surroundings(rgba: Picture, finest: float) -> Picture:
    """Cut to a rectangle around the object, as far as the picture has it; shrink if need be.

    Args:
        rgba: (H, W, 4) uint8, straight alpha.
        finest: longest extent in pixels that is kept.
    """
    box = find_object(rgba)
    edge = int(np.ceil(_ROOM * box.extent))
    rows = slice(max(box.top - edge, 0), box.bottom + edge)
    columns = slice(max(box.left - edge, 0), box.right + edge)
    cut = rgba[rows, columns].copy()
    scale = shrinking(box.extent, finest, 1.0)
    if scale == 1:
        return cut
    size = (round(cut.shape[1] * scale), round(cut.shape[0] * scale))
    small = cv2.resize(premultiplied(cut), size, interpolation=cv2.INTER_AREA)
    return straight(np.asarray(small, np.float32))


def _opaque(rgba: Picture) -> int:
    return int(np.count_nonzero(rgba[..., 3] > OPAQUE))


def _passes(rgba: Picture) -> bool:
    try:
        check_crop(rgba, "perturbed picture")
    except InputError:
        return False
    return True
