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
    """One arm's curves.

    Attributes:
        label: the arm's name.
        colour: its colour in all plots of a report.
        series: per state.
        ttc: (C,) seconds for each plan, or None.
    """

    label: str
    colour: palette.Colour
    series: Series
    ttc: Array | None


def rollout_plots(name: str, arms: Sequence[Curves]) -> tuple[Plot, ...]:
    """Plots of one scenario: speed, gap, TTC and acceleration, the arms together.

    Args:
        name: unique in the page; SVG ids are made from it.
        arms: at least one; the actor's and the recorded speed are those of the longest.
    """
    longest = max(arms, key=lambda m: len(m.series.time)).series
    end = float(longest.time[-1])
    return (
        _speed(f"{name}-speed", arms, longest, end),
        _gap(f"{name}-gap", arms, end),
        _ttc(f"{name}-ttc", arms, end),
        _acceleration(f"{name}-acceleration", arms, end),
    )


def coverage_plot(name: str, arm: str, coverage: RolloutCoverage, dt: float, end: float) -> Plot:
    """Shares of the vehicle in the images of each plan step; nothing where none shows it.

    Args:
        name: unique in the page.
        arm: its name for people.
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
    title = f"What was shown of the {arm} [%]"
    return finish(name, title, f"over all images: {told}", figure, end)


def _speed(name: str, arms: Sequence[Curves], longest: Series, end: float) -> Plot:
    figure, axes = blank_axes(end)
    for arm, width in _with_widths(arms):
        axes.plot(
            arm.series.time,
            arm.series.ego_speed,
            color=palette.css(arm.colour),
            lw=width,
        )
    axes.plot(longest.time, longest.actor_speed, color=palette.css(palette.ACTOR), lw=1.6)
    axes.plot(longest.time, longest.log_ego_speed, color=INK, lw=1, ls=":")
    axes.set_ylim(bottom=0.0)
    alt = "; ".join(
        f"ego with {m.label}: {m.series.ego_speed[0]:.1f} m/s at the start, "
        f"{m.series.ego_speed[-1]:.1f} m/s at the end"
        for m in arms
    )
    return finish(name, "Speed [m/s]", alt, figure, end)


def _gap(name: str, arms: Sequence[Curves], end: float) -> Plot:
    figure, axes = blank_axes(end)
    for arm, width in _with_widths(arms):
        colour, curves = palette.css(arm.colour), arm.series
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
        for m in arms
    )
    return finish(name, "Gap between the boxes [m]", alt, figure, end)


def _ttc(name: str, arms: Sequence[Curves], end: float) -> Plot:
    figure, axes = blank_axes(end)
    axes.axhline(CAP, color=FAINT, lw=1, ls="--")
    told = []
    for arm, width in _with_widths(arms):
        if arm.ttc is None or len(arm.ttc) == 0:
            continue
        axes.plot(
            arm.series.plan_time,
            arm.ttc,
            "o-",
            color=palette.css(arm.colour),
            lw=width,
            ms=width + 2,
        )
        told.append(f"{arm.label}: least {arm.ttc.min():.1f} s")
    axes.set_ylim(-0.1, CAP + 0.3)
    return finish(
        name, f"Time to collision of each plan [s], capped at {CAP:g}",
        "; ".join(told) or "no metrics", figure, end,
    )  # fmt: skip


def _acceleration(name: str, arms: Sequence[Curves], end: float) -> Plot:
    figure, axes = blank_axes(end)
    low, high = LIMITS["lon_accel"]
    for limit in (low, high):
        axes.axhline(limit, color=INK, lw=0.8, ls="--", alpha=0.5)
    for arm, width in _with_widths(arms):
        axes.plot(
            arm.series.time,
            arm.series.acceleration,
            color=palette.css(arm.colour),
            lw=width,
        )
    alt = "; ".join(
        f"{m.label}: between {m.series.acceleration.min():.1f} and "
        f"{m.series.acceleration.max():.1f} m/s²"
        for m in arms
    )
    title = f"Ego acceleration, driven [m/s²]; dashed: comfort {low:g} to {high:g}"
    return finish(name, title, alt, figure, end)


def _with_widths(arms: Sequence[Curves]) -> list[tuple[Curves, float]]:
    # Arms often drive alike: the earlier ones are wider, so that they show under the later.
    return [(m, 1.6 + 1.8 * (len(arms) - 1 - i)) for i, m in enumerate(arms)]
