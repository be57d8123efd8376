"""Plots as SVG that takes its text colour from the page around it."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

_INCHES = (5.6, 2.4)
_LEFT, _RIGHT, _BOTTOM, _TOP = 0.085, 0.985, 0.16, 0.97
# Stand-ins that matplotlib takes for colours, replaced by what CSS knows once the SVG is text.
INK, FAINT = "#010203", "#040506"
_CSS = {INK: "currentColor", FAINT: "var(--line)"}


@dataclass(frozen=True)
class Plot:
    """One plot, ready to be put into HTML.

    Attributes:
        title: with the unit.
        alt: what it shows, in words.
        svg: `<svg>` element with `currentColor` as ink and no background.
        left, right: where 0 and `time_end` lie, as shares of the width.
        time_end: what lies at the right end of the axis; seconds where it is one of time.
    """

    title: str
    alt: str
    svg: str
    left: float
    right: float
    time_end: float


def blank_axes(end: float, label: str = "time [s]") -> tuple[Figure, Axes]:
    """Axes from 0 to `end` on no background, as every plot of a report begins."""
    figure = Figure(figsize=_INCHES)
    axes = figure.add_axes((_LEFT, _BOTTOM, _RIGHT - _LEFT, _TOP - _BOTTOM))
    axes.set_xlim(0.0, end)
    axes.set_xlabel(label, color=INK, fontsize=8.5, labelpad=1)
    axes.patch.set_visible(False)
    figure.patch.set_visible(False)
    axes.grid(color=FAINT, lw=0.6)
    axes.tick_params(colors=INK, labelsize=8.5, length=0)
    for side, spine in axes.spines.items():
        spine.set_visible(side == "bottom")
        spine.set_color(INK)
    return figure, axes


def finish(name: str, title: str, alt: str, figure: Figure, end: float) -> Plot:
    """The figure as SVG.

    Args:
        name: unique in the page; SVG ids are made from it.
    """
    stream = io.StringIO()
    # Ids in the SVG are hashes of this salt: without one they are random, and with the same one
    # two plots of a page would share them.
    with matplotlib.rc_context({"svg.hashsalt": name, "svg.fonttype": "none"}):
        FigureCanvasSVG(figure).print_svg(
            stream, metadata={"Date": None, "Creator": None, "Format": None, "Type": None}
        )
    text = stream.getvalue()
    return Plot(title, alt, _for_html(text), _LEFT, _RIGHT, end)


def _for_html(svg: str) -> str:
    """The bare element: no XML head, no styles that would reach the page, no ids that repeat."""
    text = svg[svg.index("<svg") :]
    text = re.sub(r"<style.*?</style>", "", text, flags=re.DOTALL)
    text = re.sub(r'\s+xmlns(:xlink)?="[^"]*"', "", text)
    text = re.sub(r' id="([^"]*)"', lambda m: m[0] if f"#{m[1]}" in text else "", text)
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    for colour, css in _CSS.items():
        text = text.replace(colour, css)
    return text
