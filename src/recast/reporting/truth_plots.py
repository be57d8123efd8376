"""How alike both actors and the truth are, over the angle from the log."""

from __future__ import annotations

import numpy as np

from recast.reporting import palette
from recast.reporting.figure import FAINT, Plot, blank_axes, finish
from recast.reporting.truth_inputs import TruthPart

_LIMIT = 60.0  # degrees beyond which a view is one that the log never had
_BINS = ((0, 30), (30, 60), (60, 90), (90, 120), (120, 150), (150, 180.1))

_TITLES = {"mask_iou": "Mask IoU with the truth", "psnr": "PSNR inside the vehicle's box [dB]"}


def truth_plots(part: TruthPart) -> tuple[Plot, ...]:
    """One plot a measure: a dot a view, a line through the means of 30 degrees each."""
    return tuple(_plot(part, measure, title) for measure, title in _TITLES.items())


def _plot(part: TruthPart, measure: str, title: str) -> Plot:
    figure, axes = blank_axes(180.0, "degrees from the nearest logged view; shaded: 60 and more")
    axes.axvspan(_LIMIT, 180.0, color=FAINT, alpha=0.35, lw=0)
    axes.set_xticks(range(0, 181, 30))
    angles = np.array([view.angle for view in part.views.views])
    told = []
    for arm, index in part.colours.items():
        colour = palette.css(palette.arm_colour(index))
        values = np.array([getattr(getattr(v, arm), measure) for v in part.views.views])
        axes.plot(angles, values, "o", color=colour, ms=4, alpha=0.55, mew=0)
        members = [(angles >= low) & (angles < high) for low, high in _BINS]
        means = [(angles[m].mean(), values[m].mean()) for m in members if m.any()]
        axes.plot(*np.array(means).T, "-", color=colour, lw=2.2)
        beyond = values[angles >= _LIMIT]
        if len(beyond):
            told.append(f"{part.names[arm]}: mean {beyond.mean():.2f} beyond {_LIMIT:.0f} degrees")
    if measure == "mask_iou":
        axes.set_ylim(0.0, 1.02)
    return finish(f"truth-{measure}", title, "; ".join(told) or title, figure, 180.0)
