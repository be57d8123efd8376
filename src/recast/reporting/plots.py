"""What happens over time in a rollout, as series and as curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from recast.arrays import Array
from recast.dynamics.comfort import PLAN_LIMITS
from recast.geometry import boxes, se2
from recast.metrics.collision import CAP, TOUCHING
from recast.reporting import palette
from recast.reporting.figure import INK, Figure, Plot
from recast.simulation.coverage import RolloutCoverage
from recast.simulation.rollout import Rollout


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
    distance = shapely.distance(
        shapely.polygons(boxes.bev_corners(boxes_of_ego, *rollout.ego_size)),
        shapely.polygons(boxes.bev_corners(actor, *rollout.actor_size[:2])),
    )
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
    colour: palette.Colour
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
    for column, colour in zip(shares.T, palette.SHARES.values(), strict=True):
        above = below + 100 * column
        figure.bars(steps * dt, width, below, above, palette.css(colour))
        below = above
    told = ", ".join(f"{key} {getattr(coverage.mean, key):.0%}" for key in palette.SHARES)
    return figure.plot(f"Visible part of the {arm}", f"over all images: {told}")


_Drawn = tuple[Figure, str, str]
"""A figure, its title, and what it shows in words."""


def _ttc(arms: Sequence[Curves], longest: Series) -> _Drawn:
    figure = Figure(float(longest.time[-1]), 0.0, CAP + 0.5, "time to collision [s]")
    figure.level(CAP, f"{CAP:g} s: the plan hits nothing")
    told = []
    for arm, width in _with_widths(arms):
        if arm.ttc is None or len(arm.ttc) == 0:
            continue
        colour = palette.css(arm.colour)
        figure.line(arm.series.plan_time, arm.ttc, colour, width)
        figure.dots(arm.series.plan_time, arm.ttc, colour, width / 2 + 2.2)
        told.append(f"{arm.label}: least {arm.ttc.min():.1f} s")
    return figure, "Time to collision of each plan", "; ".join(told) or "no metrics"


def _speed(arms: Sequence[Curves], longest: Series) -> _Drawn:
    speeds = [longest.actor_speed, longest.log_ego_speed, *(m.series.ego_speed for m in arms)]
    figure = _from_zero(longest, max(float(values.max()) for values in speeds), "speed [m/s]")
    for arm, width in _with_widths(arms):
        figure.line(arm.series.time, arm.series.ego_speed, palette.css(arm.colour), width)
    figure.line(longest.time, longest.actor_speed, palette.css(palette.ACTOR), 2)
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
        figure.line(arm.series.time, arm.series.gap, palette.css(arm.colour), width)
    for arm in arms:
        hit = arm.series.collision_step
        if hit is not None:
            figure.cross(float(arm.series.time[hit]), 0.0, palette.css(arm.colour))
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
        figure.line(arm.series.time, arm.series.acceleration, palette.css(arm.colour), width)
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
