"""Plots as SVG that takes its text colour and its font from the page around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import ArrayLike

WIDTH, HEIGHT = 600, 270
"""Of a plot, pixels on a page that is 1280 pixels wide."""
_LEFT, _RIGHT, _TOP, _BOTTOM = 56, 590, 18, 222
INK, FAINT = "currentColor", "var(--line)"
"""Colours that the page defines, in light and in dark."""


@dataclass(frozen=True)
class Plot:
    """One plot, ready to be put into HTML.

    Attributes:
        svg: `<svg>` element with `currentColor` as ink and no background.
        left, right: places of 0 and `time_end`, as shares of the width.
        time_end: what lies at the right end of the axis; seconds if it is one of time.
    """

    title: str
    alt: str
    svg: str
    left: float
    right: float
    time_end: float


class Figure:
    """Axes with labels and a grid, to draw on in data coordinates.

    Args:
        horizontal: label of the horizontal axis, with its unit.
        every: distance between the numbers of the horizontal axis; None chooses one.
        end, low, high: the horizontal axis goes from 0 to `end`, the vertical from `low` to `high`.
    """

    def __init__(
        self,
        end: float,
        low: float,
        high: float,
        label: str,
        horizontal: str = "time [s]",
        every: float | None = None,
    ) -> None:
        self.end, self.low, self.high = max(end, 1e-9), low, max(high, low + 1e-9)
        self._parts: list[str] = []
        for value in ticks(self.low, self.high, 5):
            y = self._y(value)
            self._rule(_LEFT, y, _RIGHT, y, FAINT)
            self._text(_LEFT - 8, y + 4, f"{value:g}", "end")
        for value in ticks(0.0, self.end, 8, every):
            x = self._x(value)
            self._rule(x, _TOP, x, _BOTTOM, FAINT)
            self._text(x, _BOTTOM + 19, f"{value:g}", "middle")
        self._rule(_LEFT, _BOTTOM, _RIGHT, _BOTTOM, INK)
        self._text((_LEFT + _RIGHT) / 2, HEIGHT - 8, horizontal, "middle")
        middle = (_TOP + _BOTTOM) / 2
        turned = f' transform="rotate(-90 14 {middle:.0f})"'
        self._text(14, middle, label, "middle", turned)

    def line(
        self, x: ArrayLike, y: ArrayLike, colour: str, width: float = 1.6, dash: str = ""
    ) -> None:
        """Draw a line through points (N,), `width` pixels wide."""
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in self._points(x, y))
        dashed = f' stroke-dasharray="{dash}"' if dash else ""
        self._parts.append(
            f'<polyline points="{points}" fill="none" stroke="{colour}" '
            f'stroke-width="{width:g}"{dashed}/>'
        )

    def dots(
        self, x: ArrayLike, y: ArrayLike, colour: str, radius: float = 3.0, opacity: float = 1.0
    ) -> None:
        """Draw discs of `radius` pixels at points (N,)."""
        discs = "".join(
            f'<circle cx="{a:.1f}" cy="{b:.1f}" r="{radius:g}"/>' for a, b in self._points(x, y)
        )
        self._parts.append(f'<g fill="{colour}" fill-opacity="{opacity:g}">{discs}</g>')

    def cross(self, x: float, y: float, colour: str) -> None:
        """Draw a cross at a point."""
        [(a, b)] = self._points([x], [y])
        path = f"M{a - 6:.1f} {b - 6:.1f}l12 12m0 -12l-12 12"
        for stroke, width in ((INK, 5), (colour, 3)):
            self._parts.append(f'<path d="{path}" stroke="{stroke}" stroke-width="{width}"/>')

    def level(self, y: float, words: str) -> None:
        """Draw a dashed line at a value, its meaning above its right end."""
        self._rule(_LEFT, self._y(y), _RIGHT, self._y(y), INK, "5 4")
        self._text(_RIGHT - 4, self._y(y) - 8, words, "end", ' font-size="11.5" fill-opacity=".75"')

    def steps(self, x: ArrayLike) -> None:
        """Mark times (N,) by short strokes on the horizontal axis."""
        for at in np.asarray(x, np.float64):
            self._rule(self._x(at), _BOTTOM, self._x(at), _BOTTOM - 7, INK)

    def moments(self, x: Sequence[float]) -> None:
        """Mark times by dashed lines with the numbers 1, 2, ... above them."""
        for number, at in enumerate(x, 1):
            self._rule(self._x(at), _TOP, self._x(at), _BOTTOM, INK, "2 3")
            self._text(self._x(at), _TOP - 5, str(number), "middle", ' font-weight="700"')

    def band(self, first: float, last: float) -> None:
        """Shade a range of the horizontal axis."""
        x, width = self._x(first), self._x(last) - self._x(first)
        self._parts.append(
            f'<rect x="{x:.1f}" y="{_TOP}" width="{width:.1f}" height="{_BOTTOM - _TOP}" '
            f'fill="{FAINT}" fill-opacity=".35"/>'
        )

    def bars(
        self, x: ArrayLike, width: float, low: ArrayLike, high: ArrayLike, colour: str
    ) -> None:
        """Draw bars (N,) that begin at `x` and reach from `low` to `high`."""
        boxes = []
        for (a, b), (_, c) in zip(self._points(x, low), self._points(x, high), strict=True):
            w = min(self._x(width) - self._x(0.0), _RIGHT - a)
            boxes.append(f'<rect x="{a:.1f}" y="{c:.1f}" width="{w:.1f}" height="{b - c:.1f}"/>')
        # An edge of the same colour: the page would shine through between the bars.
        joined = "".join(boxes)
        self._parts.append(f'<g fill="{colour}" stroke="{colour}" stroke-width=".6">{joined}</g>')

    def plot(self, title: str, alt: str) -> Plot:
        """What was drawn, as SVG."""
        svg = (
            f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" font-size="13" fill="{INK}" '
            f'stroke-linejoin="round">{"".join(self._parts)}</svg>'
        )
        return Plot(title, alt, svg, _LEFT / WIDTH, _RIGHT / WIDTH, self.end)

    def _x(self, value: float) -> float:
        return _LEFT + (_RIGHT - _LEFT) * float(value) / self.end

    def _y(self, value: float) -> float:
        share = (float(value) - self.low) / (self.high - self.low)
        return _BOTTOM - (_BOTTOM - _TOP) * share

    def _points(self, x: ArrayLike, y: ArrayLike) -> list[tuple[float, float]]:
        """Pixels of points; what lies beyond the axes is drawn at their ends."""
        inside = np.clip(np.asarray(y, np.float64), self.low, self.high)
        return [
            (self._x(a), self._y(b)) for a, b in zip(np.asarray(x, np.float64), inside, strict=True)
        ]

    def _rule(
        self, x1: float, y1: float, x2: float, y2: float, colour: str, dash: str = ""
    ) -> None:
        dashed = f' stroke-dasharray="{dash}"' if dash else ""
        self._parts.append(
            f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" '
            f'stroke="{colour}"{dashed}/>'
        )

    def _text(self, x: float, y: float, words: str, anchor: str, more: str = "") -> None:
        self._parts.append(
            f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{more}>{escape(words)}</text>'
        )


def ticks(low: float, high: float, most: int, every: float | None = None) -> list[float]:
    """Round numbers from `low` to `high`, 1, 2 or 5 times a power of ten apart.

    There are `most` at most, give or take one; or `every` is the distance between them.
    """
    if every is None:
        rough = (high - low) / most
        power = 10.0 ** np.floor(np.log10(rough))
        every = next(float(power * f) for f in (1, 2, 5, 10) if power * f >= rough * (1 - 1e-9))
    first, last = int(np.ceil(low / every - 1e-9)), int(np.floor(high / every + 1e-9))
    return [round(number * every, 9) for number in range(first, last + 1)]
