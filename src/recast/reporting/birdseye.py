"""A rollout seen from above: as a video, at one moment, and as one still picture of all of it.

`MapLayer` and the `draw_` functions draw the map, cars, plans, recorded paths and words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from recast.arrays import Array, Image
from recast.geometry import boxes
from recast.logs.hdmap import HdMap
from recast.reporting import drawing
from recast.reporting.drawing import Canvas, CanvasView, dashed
from recast.reporting.plots import Series, planned_paths, series
from recast.simulation.rollout import Rollout

_MARGIN = 6.0  # metres around everything
_MAX_SCALE = 14.0  # pixels a metre
FURTHER = 0.6
"""Share of the target's colour that the scenario's actors beside it have."""
TRAFFIC = 0.3
"""The same of the traffic."""
_DASH = 1.5  # metres
_DOT = 0.5  # seconds between the dots of a plan


class MapLayer:
    """A map made ready to be drawn many times: what lies outside of the view costs nothing.

    Args:
        hd_map: lanes and drivable area; None draws the grid alone.
    """

    def __init__(self, hd_map: HdMap | None) -> None:
        lanes = [] if hd_map is None else list(hd_map.lanes.values())
        outlines = [] if hd_map is None else list(hd_map.drivable_area)
        self._areas = _Shapes.of([*outlines, *(lane.polygon for lane in lanes)])
        self._centrelines = _Shapes.of(
            [piece for lane in lanes for piece in dashed(lane.centreline, 1.5)]
        )
        self._boundaries = _Shapes.of(
            [
                line
                for lane in lanes
                if not lane.is_intersection
                for line in (lane.left_boundary, lane.right_boundary)
            ]
        )

    def draw(self, canvas: Canvas) -> None:
        """Draw a ten-metre grid, the drivable area, and the lanes."""
        low, high = canvas.view.footprint.min(axis=0), canvas.view.footprint.max(axis=0)
        columns = np.arange(np.ceil(low[0] / 10) * 10, high[0], 10.0)
        rows = np.arange(np.ceil(low[1] / 10) * 10, high[1], 10.0)
        grid = [np.array([[x, low[1]], [x, high[1]]]) for x in columns]
        grid += [np.array([[low[0], y], [high[0], y]]) for y in rows]
        canvas.lines(grid, drawing.GRID)
        canvas.polygons(self._areas.within(low, high), drawing.DRIVABLE)
        canvas.lines(self._centrelines.within(low, high), drawing.CENTRELINE)
        canvas.lines(self._boundaries.within(low, high), drawing.BOUNDARY)


@dataclass(frozen=True)
class _Shapes:
    """Chains of points (N_i, 2) with their bounds `low`, `high` (M, 2)."""

    chains: tuple[Array, ...]
    low: Array
    high: Array

    @classmethod
    def of(cls, chains: Sequence[Array]) -> _Shapes:
        flat = tuple(np.asarray(chain, np.float64)[:, :2] for chain in chains)
        low = np.array([chain.min(axis=0) for chain in flat]).reshape(-1, 2)
        high = np.array([chain.max(axis=0) for chain in flat]).reshape(-1, 2)
        return cls(flat, low, high)

    def within(self, low: Array, high: Array) -> list[Array]:
        """Those whose bounds meet the rectangle."""
        meets = np.all((self.low <= high) & (self.high >= low), axis=1)
        return [self.chains[i] for i in np.flatnonzero(meets)]


def fitted_view(points: Array, heading: float, width: int, max_height: int) -> CanvasView:
    """The view that holds points (N, 2) with a margin, at 14 pixels a metre at most.

    Args:
        heading: world direction, radians, that points to the right.
        width: width of the picture, pixels; its height is at least a fifth of that, and at most
            `max_height`.
    """
    turned = CanvasView(np.zeros(2), heading, 1.0, 0, 0).pixels(points)
    low, high = turned.min(axis=0) - _MARGIN, turned.max(axis=0) + _MARGIN
    span = high - low
    scale = min(width / span[0], max_height / span[1], _MAX_SCALE)
    height = int(np.clip(span[1] * scale, width / 5, max_height))
    centre = CanvasView(np.zeros(2), heading, 1.0, 0, 0).world((low + high) / 2)
    return CanvasView(centre, heading, scale, width, height - height % 2)


def draw_car(
    canvas: Canvas,
    pose: Array,
    size: Array,
    colour: drawing.Colour,
    edge: drawing.Colour = drawing.GROUND,
    edge_width: int = 1,
) -> None:
    """A filled box (length, width) at a pose (3,) of its centre, with a windscreen."""
    outline = boxes.bev_corners(pose, *size)
    canvas.polygon(outline, colour)
    # A dark band a third from the front tells front from rear at any scale.
    length, width = size[0] * 0.16, size[1] * 0.78
    ahead = size[0] * 0.20
    centre = pose + np.array([ahead * np.cos(pose[2]), ahead * np.sin(pose[2]), 0.0])
    canvas.polygon(boxes.bev_corners(centre, length, width), drawing.dimmed(colour, 0.35))
    canvas.line(outline, edge, edge_width, closed=True)


def draw_scale_bar(canvas: Canvas, metres: float = 10.0, size: int = 17) -> None:
    """A bar of `metres` in the lower right corner; letters of `size` pixels."""
    right, y = canvas.view.width - 16.0, canvas.view.height - 1.3 * size
    left = right - metres * canvas.view.scale
    canvas.line(canvas.view.world([[left, y], [right, y]]), drawing.TEXT, 2)
    canvas.text(((left + right) / 2, y - 5), f"{metres:.0f} m", drawing.TEXT, size, "mb")


@dataclass(frozen=True)
class References:
    """What was recorded: the route, and where ego and actor drove in the log."""

    route: Array
    ego: list[Array]
    actor: list[Array]

    @classmethod
    def of(cls, rollout: Rollout, actor_log_path: Array | None) -> References:
        """Recorded paths of a rollout, cut into dashes."""
        moved = np.ptp(rollout.log_ego[:, :2], axis=0).max() > 0.1
        return cls(
            rollout.route,
            dashed(rollout.log_ego, _DASH) if moved else [],
            dashed(actor_log_path, _DASH)
            if actor_log_path is not None and len(actor_log_path) > 1
            else [],
        )

    def draw(self, canvas: Canvas) -> None:
        """Draw the route, and both recorded paths dashed."""
        canvas.line(self.route, drawing.ROUTE, 1)
        canvas.lines(self.actor, drawing.dimmed(drawing.ACTOR, 0.45), 1)
        canvas.lines(self.ego, drawing.LOGGED, 1)


def draw_plan(canvas: Canvas, plan: Array, dt: float) -> None:
    """Draw a plan (41, 2) with a dot every 0.5 s."""
    canvas.line(plan, drawing.PLAN, 2)
    every = max(1, round(_DOT / dt))
    canvas.dots(plan[every::every], drawing.PLAN, 2.5)


def draw_cars(canvas: Canvas, rollout: Rollout, step: int, touching: bool) -> None:
    """Draw the ego, the ego as recorded, and all controlled actors at a step."""
    log_pose = rollout.log_ego[step, :3].copy()
    log_pose[:2] += rollout.ego_centre_offset * np.array([np.cos(log_pose[2]), np.sin(log_pose[2])])
    canvas.line(boxes.bev_corners(log_pose, *rollout.ego_size), drawing.LOGGED, 1, closed=True)
    for one in rollout.controlled:
        traffic = one.track_id in rollout.other_actors
        colour = drawing.dimmed(drawing.ACTOR, TRAFFIC if traffic else FURTHER)
        draw_car(canvas, one.states[step, :3], one.size[:2], colour, drawing.GROUND, 1)
    for pose, size, colour in (
        (rollout.actor[step, :3], rollout.actor_size[:2], drawing.ACTOR),
        (rollout.ego_boxes[step], rollout.ego_size, drawing.EGO),
    ):
        edge = drawing.COLLISION if touching else drawing.GROUND
        draw_car(canvas, pose, size, colour, edge, 3 if touching else 1)


def draw_ghosts(canvas: Canvas, rollout: Rollout, step: int, label: str, *, after: bool) -> None:
    """Draw outlines of ego and actor with a label; paler if `after` the first contact."""
    strength = 0.5 if after else 0.85
    for pose, size, colour, anchor, side in (
        (rollout.actor[step, :3], rollout.actor_size[:2], drawing.ACTOR, "mb", -1),
        (rollout.ego_boxes[step], rollout.ego_size, drawing.EGO, "mt", 1),
    ):
        outline = boxes.bev_corners(pose, *size)
        colour = drawing.dimmed(colour, strength)
        canvas.line(outline, colour, 1, closed=True)
        # Times of the actor stand above its boxes, those of the ego below: they often share a lane.
        rows = canvas.view.pixels(outline)[:, 1]
        y = (rows.min() if side < 0 else rows.max()) + 4 * side
        canvas.text((canvas.view.pixels(pose)[0], y), label, colour, 18, anchor)


def draw_contact_label(canvas: Canvas, rollout: Rollout, step: int, label: str) -> None:
    """Write below the ego of a step, with a line up to it."""
    x, y = canvas.view.pixels(rollout.ego_boxes[step])
    foot = canvas.view.world([[x, y], [x, y + 74]])
    canvas.line(foot, drawing.COLLISION, 1)
    canvas.text((x, y + 76), label, drawing.COLLISION, 22, "mt")


def draw_readout(canvas: Canvas, curves: Series, step: int) -> None:
    """Write time, speeds and gap at the top."""
    gap = ("CONTACT", drawing.COLLISION)
    if not curves.contact[step]:
        gap = (f"gap {curves.gap[step]:.1f} m", drawing.TEXT)
    columns = (
        (16, f"{curves.time[step]:.1f} s", drawing.TEXT),
        (110, f"ego {curves.ego_speed[step]:.1f} m/s", drawing.EGO),
        (290, f"actor {curves.actor_speed[step]:.1f} m/s", drawing.ACTOR),
        (490, *gap),
    )
    for x, text, colour in columns:
        canvas.text((x, 14), text, colour, 21)


def draw_legend(canvas: Canvas, rollout: Rollout, has_actor_log: bool, size: int = 17) -> None:
    """Write what the colours mean at the bottom, in letters of `size` pixels."""
    entries = [("ego", drawing.EGO), (f"actor {rollout.track_id}", drawing.ACTOR)]
    if rollout.further:
        names = ", ".join(one.track_id for one in rollout.further)
        entries.append((f"further {names}"[:40], drawing.dimmed(drawing.ACTOR, FURTHER)))
    if rollout.traffic:
        entries.append(("traffic", drawing.dimmed(drawing.ACTOR, TRAFFIC)))
    if len(rollout.plan_steps):
        entries.append(("plan", drawing.PLAN))
    entries.append(("ego as recorded", drawing.LOGGED))
    if has_actor_log:
        entries.append(("actor as recorded", drawing.dimmed(drawing.ACTOR, 0.45)))
    x, y = 14.0, canvas.view.height - 1.3 * size
    for name, colour in entries:
        canvas.line(canvas.view.world([[x, y], [x + 1.2 * size, y]]), colour, 3)
        x += 1.2 * size + 8
        x += canvas.text((x, y), name, drawing.TEXT, size, "lm") + 1.2 * size


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
        self._references = References.of(rollout, actor_log_path)
        self._has_log = actor_log_path is not None
        self._heading = _main_direction(rollout)

    def frame(
        self, step: int, style: BirdseyeStyle, others: Sequence[tuple[Array, drawing.Colour]] = ()
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
            draw_plan(canvas, self.plans[current], rollout.dt)
        canvas.line(rollout.ego_boxes[: step + 1, :2], drawing.dimmed(drawing.EGO, 0.7), 2)
        canvas.line(rollout.actor[: step + 1, :2], drawing.dimmed(drawing.ACTOR, 0.7), 2)
        for one in rollout.further:
            canvas.line(one.states[: step + 1, :2], drawing.dimmed(drawing.ACTOR, 0.4), 2)
        for pose, colour in others:
            canvas.line(boxes.bev_corners(pose, *rollout.ego_size), colour, 3, closed=True)
        draw_cars(canvas, rollout, step, touching=bool(self.curves.contact[step]))
        if style.words:
            draw_readout(canvas, self.curves, step)
            draw_legend(canvas, rollout, self._has_log)
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
            canvas.line(plan, drawing.dimmed(drawing.PLAN, 0.55), 1)
        hit = curves.collision_step
        last = len(rollout.ego) - 1 if hit is None else hit
        further = drawing.dimmed(drawing.ACTOR, FURTHER)
        for path, colour in (
            *((one.states[:, :2], further) for one in rollout.further),
            (rollout.ego_boxes[:, :2], drawing.EGO),
            (rollout.actor[:, :2], drawing.ACTOR),
        ):
            canvas.line(path[last:], drawing.dimmed(colour, 0.5), 2)
            canvas.line(path[: last + 1], colour, 2)
        every = max(1, round(_STAMP / rollout.dt))
        for step in range(0, len(rollout.ego), every):
            seconds = f"{curves.time[step]:.0f}"
            draw_ghosts(canvas, rollout, step, seconds, after=step > last)
        draw_cars(canvas, rollout, last, touching=hit is not None)
        if hit is not None:
            words = f"contact at {curves.time[hit]:.1f} s"
            draw_contact_label(canvas, rollout, hit, words)
        draw_legend(canvas, rollout, self._has_log, size=20)
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
            *(one.states[:, :2] for one in rollout.further),
            rollout.log_ego[:, :2],
        ]
    )
    return fitted_view(drawn, heading, style.still_width, style.still_max_height)
