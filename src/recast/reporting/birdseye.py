"""A rollout seen from above: as a film, at one moment, and as one still picture of all of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from recast.arrays import Array, Image
from recast.geometry import boxes
from recast.logs.hdmap import HdMap
from recast.reporting import marks, palette
from recast.reporting.canvas import Canvas, CanvasView
from recast.reporting.marks import MapLayer, draw_scale_bar, fitted_view
from recast.reporting.plots import planned_paths, series
from recast.simulation.rollout import Rollout

_EGO_AT = 0.28  # share of the film's width behind the ego
_STAMP = 1.0  # seconds between the ghost boxes of the still


@dataclass(frozen=True)
class BirdseyeStyle:
    """Sizes of the pictures in pixels; even numbers, for the film's sake.

    Attributes:
        still_width, still_max_height: width and largest height of the picture of the whole rollout.
        span: metres across a frame; an oncoming car 55 m ahead must be in it.
        words: whether frames say time, speeds and gap, and what the colours mean.
    """

    film_width: int = 960
    film_height: int = 300
    still_width: int = 1600
    still_max_height: int = 900
    span: float = 90.0
    words: bool = True


class Birdseye:
    """A rollout made ready to be drawn at many of its steps.

    Args:
        actor_log_path: (N, 2) where the actor drove in the log, or None.
    """

    def __init__(
        self, rollout: Rollout, layer: MapLayer, actor_log_path: Array | None = None
    ) -> None:
        self.rollout, self.layer = rollout, layer
        self.curves, self.plans = series(rollout), planned_paths(rollout)
        self._references = marks.References.of(rollout, actor_log_path)
        self._has_log = actor_log_path is not None
        self._heading = _main_direction(rollout)

    def frame(
        self, step: int, style: BirdseyeStyle, others: Sequence[tuple[Array, palette.Colour]] = ()
    ) -> Image:
        """Draw one state, the ego at the left and the route's direction to the right.

        Args:
            step: number of the state, 0..S.
            others: poses (3,) of box centres of egos that other arms led elsewhere, as outlines.

        Returns:
            (film_height, film_width, 3) uint8 RGB.
        """
        rollout, heading = self.rollout, self._heading
        ahead = (0.5 - _EGO_AT) * style.span * np.array([np.cos(heading), np.sin(heading)])
        canvas = Canvas(
            CanvasView(
                centre=rollout.ego[step, :2] + ahead,
                heading=heading,
                scale=style.film_width / style.span,
                width=style.film_width,
                height=style.film_height,
            )
        )
        self.layer.draw(canvas)
        self._references.draw(canvas)
        current = np.searchsorted(rollout.plan_steps, step, side="right") - 1
        if current >= 0:
            marks.draw_plan(canvas, self.plans[current], rollout.dt)
        canvas.line(rollout.ego_boxes[: step + 1, :2], palette.dimmed(palette.EGO, 0.7), 2)
        canvas.line(rollout.actor[: step + 1, :2], palette.dimmed(palette.ACTOR, 0.7), 2)
        for one in rollout.controlled:
            canvas.line(one.states[: step + 1, :2], palette.dimmed(palette.ACTOR, 0.4), 2)
        for pose, colour in others:
            canvas.line(boxes.bev_corners(pose, *rollout.ego_size), colour, 3, closed=True)
        marks.draw_cars(canvas, rollout, step, touching=bool(self.curves.contact[step]))
        if style.words:
            marks.draw_readout(canvas, self.curves, step)
            marks.draw_legend(canvas, rollout, self._has_log)
        draw_scale_bar(canvas)
        return canvas.image

    def still(self, style: BirdseyeStyle) -> Image:
        """Draw the whole rollout in one picture: paths, plans, and the boxes once a second.

        Returns:
            (<= still_max_height, still_width, 3) uint8 RGB.
        """
        rollout, curves = self.rollout, self.curves
        canvas = Canvas(_whole_view(rollout, style))
        self.layer.draw(canvas)
        self._references.draw(canvas)
        for plan in self.plans:
            canvas.line(plan, palette.dimmed(palette.PLAN, 0.55), 1)
        hit = curves.collision_step
        last = len(rollout.ego) - 1 if hit is None else hit
        further = palette.dimmed(palette.ACTOR, marks.FURTHER)
        for path, colour in (
            *((one.states[:, :2], further) for one in rollout.controlled),
            (rollout.ego_boxes[:, :2], palette.EGO),
            (rollout.actor[:, :2], palette.ACTOR),
        ):
            canvas.line(path[last:], palette.dimmed(colour, 0.5), 2)
            canvas.line(path[: last + 1], colour, 2)
        every = max(1, round(_STAMP / rollout.dt))
        for step in range(0, len(rollout.ego), every):
            seconds = f"{curves.time[step]:.0f}"
            marks.draw_ghosts(canvas, rollout, step, seconds, after=step > last)
        marks.draw_cars(canvas, rollout, last, touching=hit is not None)
        if hit is not None:
            words = f"contact at {curves.time[hit]:.1f} s"
            marks.draw_contact_label(canvas, rollout, hit, words)
        marks.draw_legend(canvas, rollout, self._has_log, size=20)
        draw_scale_bar(canvas, size=20)
        return canvas.image


def draw_frames(
    rollout: Rollout,
    hd_map: HdMap | None = None,
    actor_log_path: Array | None = None,
    style: BirdseyeStyle | None = None,
) -> Iterator[Image]:
    """Draw each state k = 0..S, following the ego, the route's direction to the right.

    Args:
        hd_map: lanes and drivable area, or None.
        actor_log_path: (N, 2) where the actor drove in the log, or None.

    Yields:
        (film_height, film_width, 3) uint8 RGB.
    """
    drawn = Birdseye(rollout, MapLayer(hd_map), actor_log_path)
    for step in range(len(rollout.ego)):
        yield drawn.frame(step, style or BirdseyeStyle())


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
    drawn = Birdseye(rollout, MapLayer(hd_map), actor_log_path)
    return drawn.still(style or BirdseyeStyle())


def _main_direction(rollout: Rollout) -> float:
    """Where the route leads from the ego's start, as seen from afar."""
    along = rollout.route[-1] - rollout.ego[0, :2]
    if np.hypot(*along) < 5.0:
        return float(rollout.ego[0, 2])
    return float(np.arctan2(along[1], along[0]))


def _whole_view(rollout: Rollout, style: BirdseyeStyle) -> CanvasView:
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
