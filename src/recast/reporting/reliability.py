"""A reliability diagram as a picture of its own: how trust and truth go together."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recast.core.files import atomic_file, disk_errors
from recast.metrics.trust import Reliability
from recast.reporting import palette
from recast.reporting.figure import FAINT, INK, Figure

_PAPER, _DARK, _LINES = "#ffffff", "#1f2430", "#d5d8de"
"""Colours of a picture that no page gives its own."""
_LARGEST, _SMALLEST = 10.0, 3.0
"""Radius in pixels of the bin with the most rollouts, and of any; areas go with counts.

The largest dot stays whole at a trust of 1, 10 pixels from the picture's edge.
"""


def reliability_svg(found: Reliability) -> str:
    """A dot for each bin, at its mean trust and the share that agrees; on the diagonal at best."""
    figure = Figure(1.0, 0.0, 1.0, "share that agrees with the truth", "trust", every=0.2)
    figure.line([0.0, 1.0], [0.0, 1.0], INK, 1.2, "5 4")
    colour = palette.css(palette.arm_colour(0))
    bins = [(b.trust, b.agreeing, b.count) for b in found.bins]
    shown = [(t, a, n) for t, a, n in bins if t is not None and a is not None]
    figure.line([t for t, _, _ in shown], [a for _, a, _ in shown], colour)
    for trust, agreeing, count in shown:
        share = count / max(n for _, _, n in shown)
        radius = max(_SMALLEST, _LARGEST * float(np.sqrt(share)))
        figure.dots([trust], [agreeing], colour, radius, 0.8)
    title = f"{found.rollouts} rollouts in {found.scenes} scenes"
    plot = figure.plot("Reliability of the trust figure", title)
    svg = plot.svg.replace(FAINT, _LINES).replace(INK, _DARK)
    head = f'<svg xmlns="http://www.w3.org/2000/svg" style="background:{_PAPER}" '
    head += 'font-family="sans-serif" '
    return svg.replace("<svg ", head, 1).replace(">", f"><title>{plot.title}: {title}</title>", 1)


def write_reliability(found: Reliability, path: Path) -> None:
    """Write `reliability_svg`, whole or not at all.

    Raises:
        InputError: the disk refuses.
    """
    with disk_errors(path), atomic_file(path) as partial:
        partial.write_text(reliability_svg(found), encoding="utf-8")
