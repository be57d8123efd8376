"""A rollout seen from above, as a film and as one still picture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.geometry import boxes
from recast.logs.hdmap import HdMap
from recast.reporting import palette
from recast.reporting.canvas import Canvas, View, dashed
from recast.reporting.map_layer import MapLayer
from recast.reporting.map_marks import draw_car, draw_scale_bar, fitted_view
from recast.reporting.series import Series, planned_paths, series
from recast.simulation.rollout import Rollout

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_FILM_SPAN = 90.0  # metres across the film: an oncoming car 55 m ahead must be in it
_EGO_AT = 0.28  # share of the film's width behind the ego
_DASH = 1.5  # metres
_STAMP = 1.0  # seconds between the ghost boxes of the still
_FURTHER = 0.6
"""Of the target's colour: controlled actors beside it."""
_DOT = 0.5  # seconds between the dots of a plan


@dataclass(frozen=True)
class BirdseyeStyle:
    """Sizes of the pictures in pixels; even numbers, for the film's sake."""

    film_width: int = 960
    film_height: int = 300
    still_width: int = 1600
    still_max_height: int = 900


def draw_frames(
    rollout: Rollout,
    hd_map: HdMap | None = None,
    actor_log_path: Array | None = None,
    style: BirdseyeStyle | None = None,
) -> Iterator[Image]:
    """Draw each state k = 0..S, following the ego, the route's direction to the right.

    Args:
        rollout: what to draw.
        hd_map: lanes and drivable area, or None.
        actor_log_path: (N, 2) where the actor drove in the log, or None.
        style: sizes.

    Yields:
        (film_height, film_width, 3) uint8 RGB.
    """
    style = style or BirdseyeStyle()
    curves, plans = series(rollout), planned_paths(rollout)
    layer, references = MapLayer(hd_map), _References.of(rollout, actor_log_path)
    heading = _main_direction(rollout)
    ahead = (0.5 - _EGO_AT) * _FILM_SPAN * np.array([np.cos(heading), np.sin(heading)])
    for step in range(len(rollout.ego)):
        view = View(
            centre=rollout.ego[step, :2] + ahead,
            heading=heading,
            scale=style.film_width / _FILM_SPAN,
            width=style.film_width,
            height=style.film_height,
        )
        canvas = Canvas(view)
        layer.draw(canvas)
        references.draw(canvas)
        current = np.searchsorted(rollout.plan_steps, step, side="right") - 1
        if current >= 0:
            _draw_plan(canvas, plans[current], rollout.dt)
        canvas.line(rollout.ego_boxes[: step + 1, :2], palette.dimmed(palette.EGO, 0.7), 2)
        canvas.line(rollout.actor[: step + 1, :2], palette.dimmed(palette.ACTOR, 0.7), 2)
        for one in rollout.controlled:
            canvas.line(one.states[: step + 1, :2], palette.dimmed(palette.ACTOR, 0.4), 2)
        _draw_cars(canvas, rollout, step, touching=bool(curves.contact[step]))
        _draw_readout(canvas, curves, step)
        _draw_legend(canvas, rollout, actor_log_path is not None)
        draw_scale_bar(canvas)
        yield canvas.image


def draw_still(
    rollout: Rollout,
    hd_map: HdMap | None = None,
    actor_log_path: Array | None = None,
    style: BirdseyeStyle | None = None,
) -> Image:
    """Draw the whole rollout in one picture: paths, plans, and the boxes once a second.

    Args: as `draw_frames`.

    Returns:
        (<= still_max_height, still_width, 3) uint8 RGB.
    """
    style = style or BirdseyeStyle()
    curves = series(rollout)
    canvas = Canvas(_whole_view(rollout, style))
    MapLayer(hd_map).draw(canvas)
    _References.of(rollout, actor_log_path).draw(canvas)
    for plan in planned_paths(rollout):
        canvas.line(plan, palette.dimmed(palette.PLAN, 0.55), 1)
    hit = curves.collision_step
    last = len(rollout.ego) - 1 if hit is None else hit
    further = [
        (one.states[:, :2], palette.dimmed(palette.ACTOR, _FURTHER)) for one in rollout.controlled
    ]
    for path, colour in (
        *further,
        (rollout.ego_boxes[:, :2], palette.EGO),
        (rollout.actor[:, :2], palette.ACTOR),
    ):
        canvas.line(path[last:], palette.dimmed(colour, 0.5), 2)
        canvas.line(path[: last + 1], colour, 2)
    every = max(1, round(_STAMP / rollout.dt))
    for step in range(0, len(rollout.ego), every):
        _draw_ghosts(canvas, rollout, step, f"{curves.time[step]:.0f}", after=step > last)
    _draw_cars(canvas, rollout, last, touching=hit is not None)
    if hit is not None:
        _draw_contact_label(canvas, rollout, hit, f"contact at {curves.time[hit]:.1f} s")
    _draw_legend(canvas, rollout, actor_log_path is not None, size=20)
    draw_scale_bar(canvas, size=20)
    return canvas.image


def _main_direction(rollout: Rollout) -> float:
    """Where the route leads from the ego's start, as seen from afar."""
    along = rollout.route[-1] - rollout.ego[0, :2]
    if np.hypot(*along) < 5.0:
        return float(rollout.ego[0, 2])
    return float(np.arctan2(along[1], along[0]))


def _whole_view(rollout: Rollout, style: BirdseyeStyle) -> View:
    heading = _main_direction(rollout)
    drawn = np.concatenate(
        [
            boxes.bev_corners(rollout.ego_boxes, *rollout.ego_size).reshape(-1, 2),
            boxes.bev_corners(rollout.actor[:, :3], *rollout.actor_size[:2]).reshape(-1, 2),
            *(one.states[:, :2] for one in rollout.controlled),
            rollout.log_ego[:, :2],
        ]
    )
    return fitted_view(drawn, heading, style.still_width, style.still_max_height)


@dataclass(frozen=True)
class _References:
    """What was recorded: the route, and where ego and actor drove in the log."""

    route: Array
    ego: list[Array]
    actor: list[Array]

    @classmethod
    def of(cls, rollout: Rollout, actor_log_path: Array | None) -> _References:
        moved = np.ptp(rollout.log_ego[:, :2], axis=0).max() > 0.1
        return cls(
            rollout.route,
            dashed(rollout.log_ego, _DASH) if moved else [],
            dashed(actor_log_path, _DASH)
            if actor_log_path is not None and len(actor_log_path) > 1
            else [],
        )

    def draw(self, canvas: Canvas) -> None:
        canvas.line(self.route, palette.ROUTE, 1)
        canvas.lines(self.actor, palette.dimmed(palette.ACTOR, 0.45), 1)
        canvas.lines(self.ego, palette.LOGGED, 1)


def _draw_plan(canvas: Canvas, plan: Array, dt: float) -> None:
    canvas.line(plan, palette.PLAN, 2)
    every = max(1, round(_DOT / dt))
    canvas.dots(plan[every::every], palette.PLAN, 2.5)


def _draw_cars(canvas: Canvas, rollout: Rollout, step: int, touching: bool) -> None:
    log_pose = rollout.log_ego[step, :3].copy()
    log_pose[:2] += rollout.ego_centre_offset * np.array([np.cos(log_pose[2]), np.sin(log_pose[2])])
    canvas.line(boxes.bev_corners(log_pose, *rollout.ego_size), palette.LOGGED, 1, closed=True)
    for one in rollout.controlled:
        colour = palette.dimmed(palette.ACTOR, _FURTHER)
        draw_car(canvas, one.states[step, :3], one.size[:2], colour, palette.GROUND, 1)
    for pose, size, colour in (
        (rollout.actor[step, :3], rollout.actor_size[:2], palette.ACTOR),
        (rollout.ego_boxes[step], rollout.ego_size, palette.EGO),
    ):
        edge = palette.COLLISION if touching else palette.GROUND
        draw_car(canvas, pose, size, colour, edge, 3 if touching else 1)


def _draw_ghosts(canvas: Canvas, rollout: Rollout, step: int, label: str, *, after: bool) -> None:
    strength = 0.5 if after else 0.85
    for pose, size, colour, anchor, side in (
        (rollout.actor[step, :3], rollout.actor_size[:2], palette.ACTOR, "mb", -1),
        (rollout.ego_boxes[step], rollout.ego_size, palette.EGO, "mt", 1),
    ):
        outline = boxes.bev_corners(pose, *size)
        colour = palette.dimmed(colour, strength)
        canvas.line(outline, colour, 1, closed=True)
        # Times of the actor stand above its boxes, those of the ego below: they often share a lane.
        rows = canvas.view.pixels(outline)[:, 1]
        y = (rows.min() if side < 0 else rows.max()) + 4 * side
        canvas.text((canvas.view.pixels(pose)[0], y), label, colour, 18, anchor)


def _draw_contact_label(canvas: Canvas, rollout: Rollout, step: int, label: str) -> None:
    x, y = canvas.view.pixels(rollout.ego_boxes[step])
    foot = canvas.view.world([[x, y], [x, y + 74]])
    canvas.line(foot, palette.COLLISION, 1)
    canvas.text((x, y + 76), label, palette.COLLISION, 22, "mt")


def _draw_readout(canvas: Canvas, curves: Series, step: int) -> None:
    gap = ("CONTACT", palette.COLLISION)
    if not curves.contact[step]:
        gap = (f"gap {curves.gap[step]:.1f} m", palette.TEXT)
    columns = (
        (16, f"{curves.time[step]:.1f} s", palette.TEXT),
        (110, f"ego {curves.ego_speed[step]:.1f} m/s", palette.EGO),
        (290, f"actor {curves.actor_speed[step]:.1f} m/s", palette.ACTOR),
        (490, *gap),
    )
    for x, text, colour in columns:
        canvas.text((x, 14), text, colour, 21)


def _draw_legend(canvas: Canvas, rollout: Rollout, has_actor_log: bool, size: int = 17) -> None:
    entries = [("ego", palette.EGO), (f"actor {rollout.track_id}", palette.ACTOR)]
    if rollout.controlled:
        names = ", ".join(one.track_id for one in rollout.controlled)
        entries.append((f"further {names}"[:40], palette.dimmed(palette.ACTOR, _FURTHER)))
    if len(rollout.plan_steps):
        entries.append(("plan", palette.PLAN))
    entries.append(("ego as recorded", palette.LOGGED))
    if has_actor_log:
        entries.append(("actor as recorded", palette.dimmed(palette.ACTOR, 0.45)))
    x, y = 14.0, canvas.view.height - 1.3 * size
    for name, colour in entries:
        canvas.line(canvas.view.world([[x, y], [x + 1.2 * size, y]]), colour, 3)
        x += 1.2 * size + 8
        x += canvas.text((x, y), name, palette.TEXT, size, "lm") + 1.2 * size
