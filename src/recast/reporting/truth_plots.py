"""How alike both actors and the truth are, over the angle from the log."""

from __future__ import annotations

import numpy as np

from recast.reporting import palette
from recast.reporting.figure import Figure, Plot
from recast.reporting.truth_inputs import TruthPart

_LIMIT = 60.0  # degrees beyond which a view is one that the log never had
_BINS = ((0, 30), (30, 60), (60, 90), (90, 120), (120, 150), (150, 180.1))

_TITLES = {
    "mask_iou": ("Mask IoU with the truth", "mask IoU"),
    "psnr": ("PSNR inside the vehicle's box", "PSNR [dB]"),
}


def truth_plots(part: TruthPart) -> tuple[Plot, ...]:
    """One plot for each measure: a dot for each view, a line through the means of 30 degrees."""
    return tuple(_plot(part, measure, *words) for measure, words in _TITLES.items())


def _plot(part: TruthPart, measure: str, title: str, label: str) -> Plot:
    angles = np.array([view.angle for view in part.views.views])
    values = {
        arm: np.array([getattr(getattr(v, arm), measure) for v in part.views.views])
        for arm in part.colours
    }
    every = np.concatenate(list(values.values()))
    low, high = (0.0, 1.02) if measure == "mask_iou" else (every.min() - 1.0, every.max() + 1.0)
    horizontal = "angle from the nearest logged view [degrees]; shaded: 60 and more"
    figure = Figure(180.0, float(low), float(high), label, horizontal, 30.0)
    figure.band(_LIMIT, 180.0)
    told = []
    for arm, index in part.colours.items():
        colour = palette.css(palette.arm_colour(index))
        figure.dots(angles, values[arm], colour, 3.5, 0.55)
        members = [(angles >= first) & (angles < last) for first, last in _BINS]
        means = [(angles[m].mean(), values[arm][m].mean()) for m in members if m.any()]
        figure.line([at for at, _ in means], [mean for _, mean in means], colour, 2.6)
        beyond = values[arm][angles >= _LIMIT]
        if len(beyond):
            told.append(f"{part.names[arm]}: mean {beyond.mean():.2f} beyond {_LIMIT:.0f} degrees")
    return figure.plot(title, "; ".join(told) or title)
