"""Pictures of what a run is made of: an actor on one page, a scenario on the map and in numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from recast.actors import Actor, orbit, turntable
from recast.actors.actor import CandidateRecord, Coverage
from recast.actors.insert import coloured_by_shares
from recast.arrays import Array, Image
from recast.core.images import wrapped
from recast.dynamics import state as ego
from recast.geometry import boxes
from recast.geometry.boxes import TOUCHING
from recast.reporting import drawing
from recast.reporting.birdseye import MapLayer, draw_car, draw_scale_bar, fitted_view
from recast.reporting.drawing import Canvas, CanvasView, dashed
from recast.reporting.plots import first_true
from recast.simulation import PreparedRollout, RolloutSetup, ego_centre
from recast.simulation.rollout_start import ON_ROAD, on_road_shares, surveyed_road
from recast.simulation.scenario import scenario_name
from recast.splats.gaussians import C0

_Line = list[tuple[int, str, drawing.Colour]]
"""Pieces of a line of text, each at its place in pixels."""
SIDES = ("front", "front left", "left", "rear left", "rear", "rear right", "right", "front right")
"""Names of a vehicle's sides, by azimuth in steps of 45 degrees."""
_WIDTH, _MARGIN = 1600, 20
_VIEWS, _ACROSS = 8, 4
_VIEW = (_WIDTH // _ACROSS, 225)
_CROP = 330  # pixels, the longer side of the crop
_TEXT, _LINE, _GAP = 17, 24, 10
_BESIDE = _CROP + 3 * _MARGIN  # where the text beside the crop begins
_ROOM = _WIDTH - _BESIDE - 2 * _MARGIN  # for that text
_CANDIDATES = {
    "Candidates": 0,
    "generator": 110,
    "which": 260,
    "outline": 620,
    "LiDAR": 710,
    "free space": 800,
    "colour": 910,
    "score": 1000,
}
"""Headings of the columns, and their places in pixels."""
_CHECKS = ((46, 50, 58), (58, 63, 72))  # behind a transparent crop


def draw_actor_sheet(actor: Actor) -> Image:
    """Draw the source crop, where the actor comes from in words, and `draw_all_around`.

    Returns:
        (H, 1600, 3) uint8 RGB.
    """
    return np.concatenate([_sheet_header(actor), _story(actor), draw_all_around(actor)], axis=0)


def draw_all_around(actor: Actor) -> Image:
    """Draw eight views of an actor, and their shares with a legend if it has some.

    Returns:
        (H, 1600, 3) uint8 RGB.
    """
    looks = turntable(actor, views=_VIEWS, width=_VIEW[0], height=_VIEW[1])
    rows = [[_labelled(view, f"from the {side}") for view, side in zip(looks, SIDES, strict=True)]]
    strips = []
    if actor.shares is not None:
        known = _view_coverages(actor)
        strips.append(_legend(Coverage.mean(known)))
        views = _share_views(actor, _VIEWS, *_VIEW)
        rows.append(
            [_labelled(view, _percentages(one)) for view, one in zip(views, known, strict=True)]
        )
    for first in range(0, _VIEWS, _ACROSS):
        strips += [np.concatenate(row[first : first + _ACROSS], axis=1) for row in rows]
    return np.concatenate(strips, axis=0)


def turntable_frames(actor: Actor, views: int, width: int, height: int) -> Iterator[Image]:
    """Frames of a film of an actor turning once, its shares below if it has some."""
    looks = turntable(actor, views=views, width=width, height=height)
    if actor.shares is None:
        yield from looks
        return
    for above, below in zip(looks, _share_views(actor, views, width, height), strict=True):
        canvas = Canvas(_pixels(width, height))
        canvas.image[:] = below
        x = 12
        for name, colour in drawing.SHARES.items():
            x += _swatch(canvas, x, height - 20, name, colour, 22) + 24
        yield np.concatenate([above, canvas.image], axis=0)


def _share_views(actor: Actor, views: int, width: int, height: int) -> list[Image]:
    colours = [[value / 255 for value in colour] for colour in drawing.SHARES.values()]
    return turntable(coloured_by_shares(actor, colours), views=views, width=width, height=height)


def _view_coverages(actor: Actor) -> list[Coverage]:
    """What of the vehicle each of the views shows, without its shadow."""
    assert actor.shares is not None
    columns = ((actor.shares.columns - 0.5) / C0)[:, None]
    views = orbit(
        replace(actor.gaussians, sh=columns),
        actor.size,
        views=_VIEWS,
        width=_VIEW[0],
        height=_VIEW[1],
        background=(0.0, 0.0, 0.0),
        low_pass=actor.low_pass,
    )
    return [Coverage.of(view.sum(axis=(0, 1)) / 255) for view in views]


def _percentages(one: Coverage) -> str:
    return f"seen {one.seen:.0%}, mirrored {one.mirrored:.0%}, invented {one.invented:.0%}"


def _sheet_header(actor: Actor) -> Image:
    canvas = Canvas(_pixels(_WIDTH, 64), drawing.GRID)
    length, width, height = actor.size
    end = canvas.text((_MARGIN, 14), f"Track {actor.track_id} ({actor.category})", size=30)
    note = f"made by {actor.provenance.generator}; box {length:.2f} x {width:.2f} x {height:.2f} m"
    canvas.text((_MARGIN + end + 24, 24), note, drawing.LOGGED, 20)
    return canvas.image


def _story(actor: Actor) -> Image:
    """The crop, and beside it where the actor comes from, in words."""
    sections, crop = _sections(actor), _crop(actor.source)
    text_height = sum(_LINE * len(section) + _GAP for section in sections)
    height = 2 * _MARGIN + max(crop.shape[0] + _LINE, text_height)
    canvas = Canvas(_pixels(_WIDTH, height))
    y = _MARGIN
    for section in sections:
        for line in section:
            for x, text, colour in line:
                canvas.text((_BESIDE + x, y), text, colour, _TEXT)
            y += _LINE
        y += _GAP
    canvas.image[_MARGIN : _MARGIN + crop.shape[0], _MARGIN : _MARGIN + crop.shape[1]] = crop
    seen = f"{actor.provenance.camera}, frame {actor.provenance.frame}, in the log"
    canvas.text((_MARGIN, _MARGIN + crop.shape[0] + 6), seen, drawing.LOGGED, _TEXT)
    return canvas.image


def _sections(actor: Actor) -> list[list[_Line]]:
    """What is said of each step that led to the actor, a title first."""
    story = actor.provenance
    made = [f"{story.generator}, seed {story.seed}"]
    if story.details:
        made.append(", ".join(f"{name} {value}" for name, value in story.details.items()))
    seen = [line for line in story.observation.splitlines() if not line.startswith("next:")]
    refined = ["not refined: only the source view was used"]
    if story.refinement is not None:
        refined = story.refinement.explain().splitlines()
    sections = [
        _section("Generator", made),
        _section("Source view", [*seen, *story.warnings()]),
        _section("Registration", story.registration.explain().splitlines()),
        _section("Refinement", refined),
    ]
    if len(story.candidates) > 1:
        sections.insert(1, _table(story.candidates))
    return sections


def _section(title: str, sentences: Sequence[str]) -> list[_Line]:
    lines: list[_Line] = [[(0, title, drawing.LOGGED)]]
    for sentence in sentences:
        first, *others = wrapped(sentence, _TEXT, _ROOM - 26)
        lines += [[(8, first, drawing.TEXT)], *([(26, one, drawing.TEXT)] for one in others)]
    return lines


def _table(candidates: Sequence[CandidateRecord]) -> list[_Line]:
    """The candidates with their scores; one that could not be made, with the reason."""
    lines: list[_Line] = [[(x, heading, drawing.LOGGED) for heading, x in _CANDIDATES.items()]]
    places = list(_CANDIDATES.values())
    for one in candidates:
        generator, label, *scores = one.cells()
        room = places[3] if one.score is not None else _ROOM
        label, *more = wrapped(label, _TEXT, room - places[2] - 30)
        cells = ["chosen" if one.chosen else "", generator, label + ("\u2026" if more else "")]
        lines.append(
            [(x, cell, drawing.TEXT) for x, cell in zip(places, [*cells, *scores], strict=True)]
        )
    return lines


def _crop(source: Image) -> Image:
    """The crop on a checked ground, enlarged to the sheet's size."""
    scale = _CROP / max(source.shape[:2])
    size = [max(1, round(side * scale)) for side in source.shape[1::-1]]
    rgba = cv2.resize(source, size, interpolation=cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA)
    row, column = np.indices(rgba.shape[:2]) // 15
    ground = np.array(_CHECKS)[(row + column) % 2]
    alpha = rgba[..., 3:] / 255
    return np.rint(alpha * rgba[..., :3] + (1 - alpha) * ground).astype(np.uint8)


def _legend(mean: Coverage) -> Image:
    canvas = Canvas(_pixels(_WIDTH, 52), drawing.GRID)
    x = _MARGIN
    for name, colour in drawing.SHARES.items():
        label = f"{name} {getattr(mean, name):.0%}"
        x += _swatch(canvas, x, 26, label, colour, 21) + 40
    note = "of the surface in these eight views: seen in the log, mirrored from the seen side,"
    note += " or invented by the generator"
    canvas.text((x, 26), note, drawing.LOGGED, _TEXT, "lm")
    return canvas.image


def _swatch(canvas: Canvas, x: int, y: int, label: str, colour: drawing.Colour, size: int) -> int:
    """A square of the colour and its name, centred on `y`; the width of both."""
    half = size // 2
    canvas.image[y - half : y + half, x : x + 2 * half] = colour
    return 2 * half + 8 + canvas.text((x + 2 * half + 8, y), label, drawing.TEXT, size, "lm")


def _labelled(picture: Image, label: str) -> Image:
    height, width = picture.shape[:2]
    canvas = Canvas(_pixels(width, height + 28))
    canvas.image[:height] = picture
    canvas.text((width / 2, height + 14), label, drawing.TEXT, 16, "mm")
    return canvas.image


def _pixels(width: int, height: int) -> CanvasView:
    """A view that is only drawn on in pixels."""
    return CanvasView(np.zeros(2), 0.0, 1.0, width, height)


_MAX_HEIGHT = 620
_HEADER = 92  # pixels
_DASH = 1.5  # metres
_RAMP: tuple[drawing.Colour, ...] = (drawing.ACTOR, (236, 84, 150), (150, 108, 255))
"""Colours of the first, the middle and the last moment."""
_APART = 44  # pixels between two labels
_ASIDE = 36  # pixels from the ego's side, beyond its labels, to the line that measures the gap
_BESIDE_ROUTE = 5.0  # metres on each side of the route: the bar at its end


@dataclass(frozen=True)
class ScenarioFacts:
    """What a scenario becomes at one place; metres, m/s, seconds after the start.

    Attributes:
        start: seconds after the first pose of the log.
        ego_speed: speed of the ego at the start.
        actor_speeds: speeds of the actor at the start and at the end.
        gap: distance along the route from the ego's front bumper to the actor's near end, at the
            start.
        laterals: lateral offsets of the actor from the route, left positive, at the start and at
            the end.
        meets_log: time when the actor's box and that of the ego as recorded first overlap, or None.
        off_road: time when less than half of the actor's box is on a surveyed map's road, or None.
        seconds, asked: how long the rollout can be at most, and was asked to be.
        cut_reason: reason why that is less, or None.
    """

    name: str
    start: float
    ego_speed: float
    gap: float
    actor_speeds: tuple[float, float]
    laterals: tuple[float, float]
    meets_log: float | None
    off_road: float | None
    seconds: float
    asked: float
    cut_reason: str | None


def scenario_facts(setup: RolloutSetup, prepared: PreparedRollout) -> ScenarioFacts:
    """Measure a prepared rollout."""
    actor, vehicle, size = prepared.actor, setup.vehicle, setup.track.size
    s, lateral = prepared.route.project(actor)
    logged = ego_centre(prepared.log_ego[:, :3], vehicle.centre_offset)
    overlap = boxes.bev_overlap_area(logged, (vehicle.length, vehicle.width), actor[:, :3], size)
    shares = on_road_shares(surveyed_road(setup.hdmap), actor[:, :3], size)
    bumper = float(prepared.route.project(prepared.ego)[0]) + vehicle.front_length
    first = setup.log.world_from_rig.timestamps_us[0]
    return ScenarioFacts(
        name=scenario_name(setup.motion),
        start=float(prepared.start_timestamp_us - first) * 1e-6,
        ego_speed=float(prepared.ego[ego.VX]),
        gap=float(s[0]) - size[0] / 2 - bumper,
        actor_speeds=(float(actor[0, 3]), float(actor[-1, 3])),
        laterals=(float(lateral[0]), float(lateral[-1])),
        meets_log=_first(overlap > TOUCHING, setup.dt),
        off_road=_first(shares < ON_ROAD, setup.dt),
        seconds=prepared.steps * setup.dt,
        asked=setup.steps * setup.dt,
        cut_reason=prepared.cut_reason,
    )


def facts_table(facts: Sequence[ScenarioFacts]) -> Table:
    """One row a scenario; `notes` says what does not fit into it."""
    table = Table(box=SIMPLE_HEAD, caption="contact: if the ego drove as recorded")
    for heading in ("scenario", "gap m", "actor m/s", "beside m", "contact", "rollout s"):
        table.add_column(heading, no_wrap=True)
    for one in facts:
        table.add_row(
            one.name,
            f"{one.gap:.1f}",
            _change(one.actor_speeds),
            _change(one.laterals),
            "never" if one.meets_log is None else f"{one.meets_log:.1f} s",
            f"{one.seconds:g} of {one.asked:g}",
        )
    return table


def notes(facts: Sequence[ScenarioFacts]) -> list[str]:
    """What cuts the rollouts, and whether an actor leaves the road, in sentences."""
    found: dict[str, list[str]] = {}
    for one in facts:
        if one.cut_reason is not None:
            found.setdefault(one.cut_reason, []).append(one.name)
        if one.off_road is not None:
            left = f"the actor leaves the drivable area {one.off_road:.1f} s after the start"
            found.setdefault(left, []).append(one.name)
    return [f"{', '.join(names)}: {sentence}" for sentence, names in found.items()]


def _first(true: np.ndarray, dt: float) -> float | None:
    step = first_true(true)
    return None if step is None else step * dt


def _change(values: tuple[float, float]) -> str:
    first, last = (f"{value:.1f}".replace("-0.0", "0.0") for value in values)
    return first if first == last else f"{first} to {last}"


def draw_scenarios(
    scenarios: Sequence[tuple[RolloutSetup, PreparedRollout, ScenarioFacts]],
) -> Image:
    """Draw scenarios below one another.

    Each shows the map, the ego's route, the ego's box at the start and its recorded place each
    second, the actor's box each second in the colours of time, the gap and the speeds at the start,
    and where the recorded road ends.

    Returns:
        (H, 1600, 3) uint8 RGB.
    """
    panels = [part for one in scenarios for part in (_header(*one), _panel(*one))]
    return np.concatenate(panels, axis=0)


def _panel(setup: RolloutSetup, prepared: PreparedRollout, facts: ScenarioFacts) -> Image:
    vehicle, size = setup.vehicle, setup.track.size
    ego_size = np.array([vehicle.length, vehicle.width])
    ego = ego_centre(prepared.log_ego[:, :3], vehicle.centre_offset)
    further = [one for one in prepared.further if one.track_id in setup.controlled]
    drawn = np.concatenate(
        [
            boxes.bev_corners(ego[[0, -1]], *ego_size).reshape(-1, 2),
            boxes.bev_corners(prepared.actor[:, :3], *size[:2]).reshape(-1, 2),
            *(one.states[:, :2] for one in further),
            ego[:, :2],
        ]
    )
    along = prepared.route.line.points[-1] - ego[0, :2]
    heading = float(np.arctan2(along[1], along[0]))
    canvas = Canvas(fitted_view(drawn, heading, _WIDTH, _MAX_HEIGHT))
    MapLayer(setup.hdmap).draw(canvas)
    canvas.line(prepared.route.line.points, drawing.ROUTE, 2)
    canvas.lines(dashed(prepared.log_ego, _DASH), drawing.LOGGED, 1)
    _road_end(canvas, setup, prepared)

    every = round(1.0 / setup.dt)
    stamps = np.arange(0, prepared.steps + 1, every)
    for step in stamps[:0:-1]:  # the early ones lie on top
        outline = boxes.bev_corners(prepared.actor[step, :3], *size[:2])
        colour = _colour(step, prepared)
        canvas.polygon(outline, drawing.dimmed(colour, 0.3))
        canvas.line(outline, colour, 2, closed=True)
    for one in further:
        length, width = setup.track_of(one.track_id).size[:2]
        outlines = boxes.bev_corners(one.states[stamps, :3], length, width)
        for step, outline in zip(stamps[::-1], outlines[::-1], strict=True):
            canvas.line(outline, drawing.dimmed(_colour(step, prepared), 0.7), 1, closed=True)
    for step in stamps[1:]:
        canvas.dots(ego[[step], :2], _colour(step, prepared), 4)
    draw_car(canvas, prepared.actor[0, :3], size[:2], _RAMP[0])
    draw_car(canvas, ego[0], ego_size, drawing.EGO)
    left = facts.laterals[0] > -0.5  # times of the actor on its side, those of the ego on the other
    _gap(canvas, prepared, ego[0], ego_size, facts, -1 if left else 1)
    _labels(canvas, prepared.actor[stamps, :3], size[:2], above=left)
    _labels(canvas, ego[stamps], ego_size, above=not left)
    draw_scale_bar(canvas, size=18)
    return canvas.image


def _header(setup: RolloutSetup, prepared: PreparedRollout, facts: ScenarioFacts) -> Image:
    canvas = Canvas(CanvasView(np.zeros(2), 0.0, 1.0, _WIDTH, _HEADER), drawing.GRID)
    length, width = setup.track.size[:2]
    title = f"{facts.name}: {setup.description}" if setup.description else facts.name
    canvas.text((16, 10), title, drawing.TEXT, 24)
    speeds = " to ".join(dict.fromkeys(f"{speed:.1f}" for speed in facts.actor_speeds))
    x = 16.0
    for text, colour in (
        (f"{_short(setup.log.name)}, {facts.start:.1f} s after its start", drawing.TEXT),
        (f"ego {facts.ego_speed:.1f} m/s", drawing.EGO),
        (f"actor {_short(setup.track_id)} ({length:.1f} x {width:.1f} m) {speeds} m/s", _RAMP[0]),
    ):
        x += canvas.text((x, 40), text, colour, 18) + 28
    note, colour = f"{facts.seconds:.1f} s, not cut", drawing.LOGGED
    if facts.cut_reason is not None:
        note = f"cut after {facts.seconds:.1f} of {facts.asked:.1f} s: {facts.cut_reason}"
        colour = drawing.COLLISION
    canvas.text((16, 66), note, colour, 18)
    _time_bar(canvas, prepared.steps * setup.dt)
    return canvas.image


def _short(name: str) -> str:
    """A name of at most 24 characters: its beginning and its end, so that the line has room."""
    return name if len(name) <= 24 else f"{name[:12]}\u2026{name[-11:]}"


def _time_bar(canvas: Canvas, seconds: float) -> None:
    left, right, y = _WIDTH - 330, _WIDTH - 60, 52
    for x in range(left, right):
        colour = _ramp((x - left) / (right - left))
        canvas.line(canvas.view.world([[x, y], [x, y + 8]]), colour, 2)
    canvas.text((left - 8, y + 4), "0 s", drawing.TEXT, 17, "rm")
    canvas.text((right + 8, y + 4), f"{seconds:.0f} s", drawing.TEXT, 17, "lm")
    legend = "boxes: actor, dots: ego as recorded"
    canvas.text((right + 40, y - 14), legend, drawing.LOGGED, 16, "rs")


def _road_end(canvas: Canvas, setup: RolloutSetup, prepared: PreparedRollout) -> None:
    """A bar across the route where rollouts are cut, as nothing was recorded beyond."""
    end = prepared.route.length - setup.road_margin
    bar = prepared.route.pose(end, np.array([-_BESIDE_ROUTE, _BESIDE_ROUTE]))
    canvas.line(bar, drawing.COLLISION, 3)
    foot = canvas.view.pixels(bar)
    below = foot[np.argmax(foot[:, 1])]
    if 0 <= below[0] < canvas.view.width:
        right = below[0] > canvas.view.width - 200
        canvas.text(
            (below[0], below[1] + 6),
            "recorded road ends",
            drawing.COLLISION,
            17,
            "rt" if right else "mt",
        )


def _gap(
    canvas: Canvas,
    prepared: PreparedRollout,
    ego: Array,
    ego_size: Array,
    facts: ScenarioFacts,
    sign: int,
) -> None:
    """A measuring line from the ego's front to the actor's near end; `sign` 1 is left of both."""
    front = float(prepared.route.project(ego)[0]) + ego_size[0] / 2
    side = sign * (ego_size[1] / 2 + _ASIDE / canvas.view.scale)
    s = np.linspace(front, front + facts.gap, 20)
    canvas.line(prepared.route.pose(s, side), drawing.TEXT, 1)
    for end in (s[0], s[-1]):
        canvas.line(prepared.route.pose(end, side + np.array([-0.5, 0.5])), drawing.TEXT, 1)
    x, y = canvas.view.pixels(prepared.route.pose(s[10], side))
    below = canvas.view.pixels(prepared.route.pose(s[10]))[1] < y
    canvas.text(
        (x, y + (6 if below else -6)),
        f"gap {facts.gap:.1f} m",
        drawing.TEXT,
        18,
        "mt" if below else "mb",
    )


def _labels(canvas: Canvas, poses: Array, size: Array, *, above: bool) -> None:
    """Seconds 0, 1, 2, ... at boxes; where they hardly move, one label for the whole time."""
    places = canvas.view.pixels(poses)
    first = 0
    for i in range(1, len(poses) + 1):
        if i < len(poses) and np.hypot(*(places[i] - places[first])) < _APART:
            continue
        text = f"{first}"
        if i - 1 > first and i == len(poses):
            text += f" to {i - 1} s"
        rows = canvas.view.pixels(boxes.bev_corners(poses[first], *size))[:, 1]
        y = rows.min() - 5 if above else rows.max() + 5
        colour = _ramp(first / max(len(poses) - 1, 1))
        canvas.text((places[first, 0], y), text, colour, 18, "mb" if above else "mt")
        first = i


def _colour(step: int, prepared: PreparedRollout) -> drawing.Colour:
    return _ramp(step / max(prepared.steps, 1))


def _ramp(share: float) -> drawing.Colour:
    """Colour of a moment: 0 the start, 1 the end."""
    at = np.linspace(0.0, 1.0, len(_RAMP))
    red, green, blue = (round(float(np.interp(share, at, c))) for c in np.transpose(_RAMP))
    return red, green, blue
