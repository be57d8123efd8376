"""Curves of a scenario over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.evaluation.comfort import LIMITS
from recast.evaluation.ttc import CAP
from recast.reporting import palette
from recast.reporting.figure import FAINT, INK, Plot, blank_axes, finish
from recast.reporting.series import Series
from recast.simulation.coverage import RolloutCoverage

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Curves:
    """One method's curves.

    Attributes:
        label: the method's name.
        colour: its colour in all plots of a report.
        series: per state.
        ttc: (C,) seconds for each plan, or None.
    """

    label: str
    colour: palette.Colour
    series: Series
    ttc: Array | None


def rollout_plots(name: str, methods: Sequence[Curves]) -> tuple[Plot, ...]:
    """Plots of one scenario: speed, gap, TTC and acceleration, the methods together.

    Args:
        name: unique in the page; SVG ids are made from it.
        methods: at least one; the actor's and the recorded speed are those of the longest.
    """
    longest = max(methods, key=lambda m: len(m.series.time)).series
    end = float(longest.time[-1])
    return (
        _speed(f"{name}-speed", methods, longest, end),
        _gap(f"{name}-gap", methods, end),
        _ttc(f"{name}-ttc", methods, end),
        _acceleration(f"{name}-acceleration", methods, end),
    )


def coverage_plot(name: str, method: str, coverage: RolloutCoverage, dt: float, end: float) -> Plot:
    """Shares of the vehicle in the images of each plan step; nothing where none shows it.

    Args:
        name: unique in the page.
        method: its name for people.
        dt: seconds between steps; the axis ends after `end` seconds.
    """
    figure, axes = blank_axes(end)
    steps, shares = coverage.by_step()
    all_steps = sorted({image.step for image in coverage.images})
    width = dt * float(np.diff(all_steps).min()) if len(all_steps) > 1 else end
    below = np.zeros(len(steps))
    for column, colour in zip(shares.T, palette.SHARES.values(), strict=True):
        paint = palette.css(colour)
        # With edges of their colour: else the page would shine through between the bars.
        axes.bar(
            steps * dt, 100 * column, width, below, align="edge", color=paint, edgecolor=paint,
            lw=0.4,
        )  # fmt: skip
        below += 100 * column
    axes.set_axisbelow(True)
    axes.set_ylim(0.0, 100.0)
    told = ", ".join(f"{key} {getattr(coverage.mean, key):.0%}" for key in palette.SHARES)
    title = f"What was shown of the {method} [%]"
    return finish(name, title, f"over all images: {told}", figure, end)


def _speed(name: str, methods: Sequence[Curves], longest: Series, end: float) -> Plot:
    figure, axes = blank_axes(end)
    for method, width in _with_widths(methods):
        axes.plot(
            method.series.time,
            method.series.ego_speed,
            color=palette.css(method.colour),
            lw=width,
        )
    axes.plot(longest.time, longest.actor_speed, color=palette.css(palette.ACTOR), lw=1.6)
    axes.plot(longest.time, longest.log_ego_speed, color=INK, lw=1, ls=":")
    axes.set_ylim(bottom=0.0)
    alt = "; ".join(
        f"ego with {m.label}: {m.series.ego_speed[0]:.1f} m/s at the start, "
        f"{m.series.ego_speed[-1]:.1f} m/s at the end"
        for m in methods
    )
    return finish(name, "Speed [m/s]", alt, figure, end)


def _gap(name: str, methods: Sequence[Curves], end: float) -> Plot:
    figure, axes = blank_axes(end)
    for method, width in _with_widths(methods):
        colour, curves = palette.css(method.colour), method.series
        axes.plot(curves.time, curves.gap, color=colour, lw=width)
        hit = curves.collision_step
        if hit is not None:
            axes.plot(
                curves.time[hit], 0.0, "X", color=colour, ms=9, mec=INK, mew=0.6, clip_on=False
            )
    axes.set_ylim(bottom=0.0)
    alt = "; ".join(
        f"{m.label}: smallest gap {m.series.gap.min():.1f} m"
        + ("" if m.series.collision_step is None else ", contact (marked with a cross)")
        for m in methods
    )
    return finish(name, "Gap between the boxes [m]", alt, figure, end)


def _ttc(name: str, methods: Sequence[Curves], end: float) -> Plot:
    figure, axes = blank_axes(end)
    axes.axhline(CAP, color=FAINT, lw=1, ls="--")
    told = []
    for method, width in _with_widths(methods):
        if method.ttc is None or len(method.ttc) == 0:
            continue
        axes.plot(
            method.series.plan_time,
            method.ttc,
            "o-",
            color=palette.css(method.colour),
            lw=width,
            ms=width + 2,
        )
        told.append(f"{method.label}: least {method.ttc.min():.1f} s")
    axes.set_ylim(-0.1, CAP + 0.3)
    return finish(
        name, f"Time to collision of each plan [s], capped at {CAP:g}",
        "; ".join(told) or "no metrics", figure, end,
    )  # fmt: skip


def _acceleration(name: str, methods: Sequence[Curves], end: float) -> Plot:
    figure, axes = blank_axes(end)
    low, high = LIMITS["lon_accel"]
    for limit in (low, high):
        axes.axhline(limit, color=INK, lw=0.8, ls="--", alpha=0.5)
    for method, width in _with_widths(methods):
        axes.plot(
            method.series.time,
            method.series.acceleration,
            color=palette.css(method.colour),
            lw=width,
        )
    alt = "; ".join(
        f"{m.label}: between {m.series.acceleration.min():.1f} and "
        f"{m.series.acceleration.max():.1f} m/s²"
        for m in methods
    )
    title = f"Ego acceleration, driven [m/s²]; dashed: comfort {low:g} to {high:g}"
    return finish(name, title, alt, figure, end)


def _with_widths(methods: Sequence[Curves]) -> list[tuple[Curves, float]]:
    # Methods often drive alike: the earlier ones are wider, so that they show under the later.
    return [(m, 1.6 + 1.8 * (len(methods) - 1 - i)) for i, m in enumerate(methods)]
