"""What happens over time in a rollout, as curves; reliability diagrams.

A `Figure` is SVG that takes its text colour and its font from the page around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array
from recast.core.files import atomic_file, disk_errors
from recast.dynamics.tracker import PLAN_LIMITS
from recast.geometry import boxes, se2
from recast.geometry.boxes import TOUCHING
from recast.metrics.driving import CAP, box_gaps
from recast.metrics.plan_agreement import MOVED, PlanAgreement
from recast.metrics.trust import Reliability
from recast.reporting import drawing
from recast.simulation.recorded_drive import DISTURBANCES
from recast.simulation.rollout import Rollout
from recast.simulation.scene_renderer import RolloutCoverage

WIDTH, HEIGHT = 600, 270
"""Size of a plot in pixels, on a page that is 1280 pixels wide."""
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
        end, low, high: the horizontal axis goes to `end`, the vertical from `low` to `high`.
        start: where the horizontal axis begins.
    """

    def __init__(
        self,
        end: float,
        low: float,
        high: float,
        label: str,
        horizontal: str = "time [s]",
        every: float | None = None,
        start: float = 0.0,
    ) -> None:
        self.start, self.end = start, max(end, start + 1e-9)
        self.low, self.high = low, max(high, low + 1e-9)
        self._parts: list[str] = []
        for value in ticks(self.low, self.high, 5):
            y = self._y(value)
            self._rule(_LEFT, y, _RIGHT, y, FAINT)
            self._text(_LEFT - 8, y + 4, f"{value:g}", "end")
        for value in ticks(start, self.end, 8, every):
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
        self,
        x: ArrayLike,
        y: ArrayLike,
        colour: str,
        radius: float = 3.0,
        opacity: float = 1.0,
        hollow: bool = False,
    ) -> None:
        """Draw discs of `radius` pixels at points (N,), or their outlines."""
        discs = "".join(
            f'<circle cx="{a:.1f}" cy="{b:.1f}" r="{radius:g}"/>' for a, b in self._points(x, y)
        )
        paint = f'fill="{colour}" fill-opacity="{opacity:g}"'
        if hollow:
            paint = f'fill="none" stroke="{colour}" stroke-opacity="{opacity:g}"'
        self._parts.append(f"<g {paint}>{discs}</g>")

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
            w = min(self._x(self.start + width) - _LEFT, _RIGHT - a)
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
        return _LEFT + (_RIGHT - _LEFT) * (float(value) - self.start) / (self.end - self.start)

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


@dataclass(frozen=True)
class Series:
    """Per state k = 0..S of a rollout.

    Attributes:
        time: (S+1,) seconds from the start.
        acceleration: (S+1,) longitudinal acceleration of the ego, m/s^2.
        ego_speed, log_ego_speed, actor_speed: (S+1,) speeds, m/s.
        gap: (S+1,) metres between the two boxes seen from above; 0 where they overlap.
        contact: (S+1,) bool, whether they overlap, as NC counts it.
        plan_time: (C,) seconds at which each plan was made.
    """

    time: Array
    ego_speed: Array
    log_ego_speed: Array
    actor_speed: Array
    acceleration: Array
    gap: Array
    contact: NDArray[np.bool_]
    plan_time: Array

    @property
    def collision_step(self) -> int | None:
        """First state with contact, or None."""
        return first_true(self.contact)


def first_true(flags: NDArray[np.bool_]) -> int | None:
    """Index of the first of flags (N,) that is set, or None."""
    return int(np.argmax(flags)) if flags.any() else None


def series(rollout: Rollout) -> Series:
    """Curves of a rollout."""
    ego = rollout.ego
    boxes_of_ego = rollout.ego_boxes
    actor = rollout.actor[:, :3]
    overlap = boxes.bev_overlap_area(boxes_of_ego, rollout.ego_size, actor, rollout.actor_size)
    distance = box_gaps(boxes_of_ego, rollout.ego_size, actor, rollout.actor_size)
    return Series(
        time=np.arange(len(ego), dtype=np.float64) * rollout.dt,
        ego_speed=np.hypot(ego[:, 3], ego[:, 4]),
        log_ego_speed=rollout.log_ego[:, 3],
        actor_speed=rollout.actor[:, 3],
        acceleration=ego[:, 5],
        gap=np.asarray(distance, np.float64),
        contact=overlap > TOUCHING,
        plan_time=rollout.plan_steps.astype(np.float64) * rollout.dt,
    )


def planned_paths(rollout: Rollout) -> Array:
    """World points (C, 41, 2) of each plan, its own ego position first."""
    start = rollout.ego[rollout.plan_steps, :3]
    world = se2.compose(start[:, None, :], rollout.predictions)
    return np.concatenate([start[:, None, :2], world[..., :2]], axis=1)


@dataclass(frozen=True)
class Curves:
    """One arm's curves.

    Attributes:
        ttc: (C,) time to collision of each plan, seconds, or None.
    """

    label: str
    colour: drawing.Colour
    series: Series
    ttc: Array | None


def rollout_plots(arms: Sequence[Curves], moments: Sequence[float] = ()) -> tuple[Plot, ...]:
    """Plots of one scenario: TTC, speed, gap and acceleration, the arms together.

    Short strokes on the time axis are the plan steps.

    Args:
        arms: curves of the arms, at least one; the actor's and the recorded speed are those of the
            longest.
        moments: seconds that are marked with the numbers 1, 2, ...
    """
    longest = max(arms, key=lambda m: len(m.series.time)).series
    plots = [
        _ttc(arms, longest),
        _speed(arms, longest),
        _gap(arms, longest),
        _acceleration(arms, longest),
    ]
    for figure, _, _ in plots:
        figure.steps(longest.plan_time)
        figure.moments(moments)
    return tuple(figure.plot(title, alt) for figure, title, alt in plots)


def coverage_plot(arm: str, coverage: RolloutCoverage, dt: float, end: float) -> Plot:
    """Shares of the vehicle in the images of each plan step; nothing if no image shows it.

    Args:
        dt: seconds between steps; the axis ends after `end` seconds.
    """
    figure = Figure(end, 0.0, 100.0, "share of its pixels [%]")
    steps, shares = coverage.by_step()
    all_steps = sorted({image.step for image in coverage.images})
    width = dt * float(np.diff(all_steps).min()) if len(all_steps) > 1 else end
    below = np.zeros(len(steps))
    for column, colour in zip(shares.T, drawing.SHARES.values(), strict=True):
        above = below + 100 * column
        figure.bars(steps * dt, width, below, above, drawing.css(colour))
        below = above
    told = ", ".join(f"{key} {getattr(coverage.mean, key):.0%}" for key in drawing.SHARES)
    return figure.plot(f"Visible part of the {arm}", f"over all images: {told}")


def agreement_plot(found: PlanAgreement, start_us: int) -> Plot:
    """How far plans on rendered images end from those on the recorded ones, over log time.

    Args:
        start_us: log time of the axis' zero.
    """
    times = [(one.timestamp_us - start_us) * 1e-6 for one in found.moments]
    fde = {
        name: [one.differences[name].fde for one in found.moments]
        for name in (*found.arms, DISTURBANCES[0])
    }
    high = max(3.0, *(max(values) for values in fde.values()))
    figure = Figure(max(times), 0.0, high * 1.05, "difference at 4 s [m]", "log time [s]")
    figure.level(MOVED, f"{MOVED:g} m: another plan")
    figure.line(times, fde[DISTURBANCES[0]], INK, 1.0, "3 3")
    for number, arm in enumerate(found.arms):
        colour = drawing.css(drawing.arm_colour(number))
        figure.line(times, fde[arm], colour)
        figure.dots(times, fde[arm], colour)
    told = ", ".join(f"{name}: at most {max(values):.1f} m" for name, values in fde.items())
    return figure.plot("Difference of the plans over time", told)


_Drawn = tuple[Figure, str, str]
"""A figure, its title, and what it shows in words."""


def _ttc(arms: Sequence[Curves], longest: Series) -> _Drawn:
    figure = Figure(float(longest.time[-1]), 0.0, CAP + 0.5, "time to collision [s]")
    figure.level(CAP, f"{CAP:g} s: the plan hits nothing")
    told = []
    for arm, width in _with_widths(arms):
        if arm.ttc is None or len(arm.ttc) == 0:
            continue
        colour = drawing.css(arm.colour)
        figure.line(arm.series.plan_time, arm.ttc, colour, width)
        figure.dots(arm.series.plan_time, arm.ttc, colour, width / 2 + 2.2)
        told.append(f"{arm.label}: least {arm.ttc.min():.1f} s")
    return figure, "Time to collision of each plan", "; ".join(told) or "no metrics"


def _speed(arms: Sequence[Curves], longest: Series) -> _Drawn:
    speeds = [longest.actor_speed, longest.log_ego_speed, *(m.series.ego_speed for m in arms)]
    figure = _from_zero(longest, max(float(values.max()) for values in speeds), "speed [m/s]")
    for arm, width in _with_widths(arms):
        figure.line(arm.series.time, arm.series.ego_speed, drawing.css(arm.colour), width)
    figure.line(longest.time, longest.actor_speed, drawing.css(drawing.ACTOR), 2)
    figure.line(longest.time, longest.log_ego_speed, INK, 1.4, "2 4")
    alt = "; ".join(
        f"ego with {m.label}: {m.series.ego_speed[0]:.1f} m/s at the start, "
        f"{m.series.ego_speed[-1]:.1f} m/s at the end"
        for m in arms
    )
    return figure, "Speed of ego and actor", alt


def _gap(arms: Sequence[Curves], longest: Series) -> _Drawn:
    figure = _from_zero(longest, max(float(m.series.gap.max()) for m in arms), "gap [m]")
    for arm, width in _with_widths(arms):
        figure.line(arm.series.time, arm.series.gap, drawing.css(arm.colour), width)
    for arm in arms:
        hit = arm.series.collision_step
        if hit is not None:
            figure.cross(float(arm.series.time[hit]), 0.0, drawing.css(arm.colour))
    alt = "; ".join(
        f"{m.label}: smallest gap {m.series.gap.min():.1f} m"
        + ("" if m.series.collision_step is None else ", contact (marked with a cross)")
        for m in arms
    )
    return figure, "Gap between the boxes of ego and actor; a cross is a contact", alt


def _acceleration(arms: Sequence[Curves], longest: Series) -> _Drawn:
    low, high = PLAN_LIMITS["lon_accel"]
    every = np.concatenate([m.series.acceleration for m in arms])
    figure = Figure(
        float(longest.time[-1]),
        min(low, float(every.min())) - 0.8,
        max(high, float(every.max())) + 0.8,
        "acceleration [m/s²]",
    )
    figure.level(low, f"comfort: {low:g}")
    figure.level(high, f"comfort: {high:g}")
    for arm, width in _with_widths(arms):
        figure.line(arm.series.time, arm.series.acceleration, drawing.css(arm.colour), width)
    alt = "; ".join(
        f"{m.label}: between {m.series.acceleration.min():.1f} and "
        f"{m.series.acceleration.max():.1f} m/s²"
        for m in arms
    )
    return figure, "Acceleration of the ego, as driven", alt


def _from_zero(longest: Series, high: float, label: str) -> Figure:
    return Figure(float(longest.time[-1]), 0.0, max(1.08 * high, 1.0), label)


def _with_widths(arms: Sequence[Curves]) -> list[tuple[Curves, float]]:
    # Arms often drive alike: the earlier ones are wider, so that they show under the later.
    wider = min(3.0, 9.0 / max(len(arms) - 1, 1))
    return [(m, 2.0 + wider * (len(arms) - 1 - i)) for i, m in enumerate(arms)]


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
    colour = drawing.css(drawing.arm_colour(0))
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
