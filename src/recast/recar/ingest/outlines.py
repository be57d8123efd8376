"""Doubts about masks: a vehicle seen from its left has the mirrored outline of its right."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from recast.arrays import Image, Mask

LEAST_OVERLAP = 0.85
"""Intersection over union of an outline and the mirrored one below which both are doubtful. On 40
synthetic vehicles of all kinds it is 0.99 at least, and 0.79 at most where a third of one mask is
missing."""
BELOW_MEDIAN = 0.1
"""A doubtful pair is also this far below the vehicle's median: azimuths that are a few degrees off
make all pairs less alike."""
LEAST_FILLED = 0.8
"""Share of its convex hull that a mask covers; 0.84 at least on the same synthetic vehicles."""
MOST_LISTED = 1 / 3
"""Share of a vehicle's views above which doubts are one line."""

_HEIGHT = 64  # pixels of an outline when it is compared
_FRONT_OFF_DEG = 15.0  # error of the front's azimuth that is allowed for


def outline_doubts(alphas: Sequence[Image], names: Sequence[str]) -> tuple[str, ...]:
    """What a person should look at: masks with holes or of parts, or unlike the mirrored view's.

    A vehicle is nearly symmetric, so the view at azimuth a shows the mirrored outline of the view
    at -a. The axis of symmetry is that about which most views agree, within `_FRONT_OFF_DEG` of the
    first view. Of a pair that differs, the view with the smaller mask is named.

    Args:
        alphas: (H, W) uint8 of the views at regular azimuths, none zero everywhere.
        names: names of the photographs.
    """
    masks = [_cut(alpha) for alpha in alphas]
    areas = [int((alpha > 127).sum()) for alpha in alphas]
    lines = {}
    for first, second, overlap in _unlike(masks):
        view, other = sorted((first, second), key=lambda index: areas[index])
        lines[view] = (
            f"{names[view]}: the mask differs from the mirrored mask of {names[other]} "
            f"(overlap {overlap:.2f}): is a part missing?"
        )
    for view, mask in enumerate(masks):
        hull = cv2.convexHull(cv2.findNonZero(mask.astype(np.uint8)))
        filled = mask.sum() / max(cv2.contourArea(hull), 1.0)
        if filled < LEAST_FILLED:
            lines[view] = (
                f"{names[view]}: the mask has holes or loose parts, fills {filled:.0%} of its hull"
            )
    if len(lines) > max(MOST_LISTED * len(masks), 1):
        doubtful = ", ".join(names[view] for view in sorted(lines))
        return (
            f"{len(lines)} of {len(masks)} masks have holes or differ from those of the other "
            f"side; check the first photograph's azimuth and these masks: {doubtful}",
        )
    return tuple(lines[view] for view in sorted(lines))


def _unlike(masks: Sequence[Mask]) -> list[tuple[int, int, float]]:
    """Doubtful pairs of views, and their overlap."""
    views = len(masks)
    most = int(2 * _FRONT_OFF_DEG * views / 360)  # steps; the mirror turns by twice the error
    best: list[tuple[int, int, float]] = []
    for turn in sorted(range(-most, most + 1), key=abs):
        pairs = [(view, (turn - view) % views) for view in range(views)]
        alike = [(i, j, _overlap(masks[i], masks[j][:, ::-1])) for i, j in pairs if i < j]
        if alike and (not best or _median(alike) > _median(best)):
            best = alike
    limit = min(LEAST_OVERLAP, _median(best) - BELOW_MEDIAN) if len(best) > 2 else LEAST_OVERLAP
    return [pair for pair in best if pair[2] < limit]


def _median(pairs: Sequence[tuple[int, int, float]]) -> float:
    return float(np.median([overlap for _, _, overlap in pairs]))


def _cut(alpha: Image) -> Mask:
    """The mask in its bounding box, scaled to a height of `_HEIGHT` pixels."""
    mask = alpha > 127 if (alpha > 127).any() else alpha > 0
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    part = mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].astype(np.uint8)
    width = max(round(part.shape[1] * _HEIGHT / part.shape[0]), 1)
    scaled = cv2.resize(part * 255, (width, _HEIGHT), interpolation=cv2.INTER_AREA)
    return np.asarray(scaled) >= 127


def _overlap(first: Mask, second: Mask) -> float:
    """Best intersection over union with the left ends, the middles or the right ends together."""
    width = max(first.shape[1], second.shape[1])
    shares = []
    for place in (0.0, 0.5, 1.0):
        wide = []
        for mask in (first, second):
            before = round((width - mask.shape[1]) * place)
            wide.append(np.pad(mask, ((0, 0), (before, width - mask.shape[1] - before))))
        shares.append((wide[0] & wide[1]).sum() / (wide[0] | wide[1]).sum())
    return float(max(shares))
