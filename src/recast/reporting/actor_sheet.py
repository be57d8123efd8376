"""An actor on one page: its source, its looks from all around, and how much of them is known."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np

from recast.actors import Actor, orbit, turntable
from recast.actors.actor import CandidateRecord, Coverage
from recast.actors.insert import coloured_by_shares
from recast.arrays import Image
from recast.core.images import wrapped
from recast.reporting import palette
from recast.reporting.canvas import Canvas, CanvasView
from recast.splats.sh import C0

_Line = list[tuple[int, str, palette.Colour]]
"""Pieces of a line of text, each at its place in pixels."""
SIDES = ("front", "front left", "left", "rear left", "rear", "rear right", "right", "front right")
"""Of a vehicle, by azimuth in steps of 45 degrees."""
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
    return np.concatenate([_header(actor), _story(actor), draw_all_around(actor)], axis=0)


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
        for name, colour in palette.SHARES.items():
            x += _swatch(canvas, x, height - 20, name, colour, 22) + 24
        yield np.concatenate([above, canvas.image], axis=0)


def _share_views(actor: Actor, views: int, width: int, height: int) -> list[Image]:
    colours = [[value / 255 for value in colour] for colour in palette.SHARES.values()]
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


def _header(actor: Actor) -> Image:
    canvas = Canvas(_pixels(_WIDTH, 64), palette.GRID)
    length, width, height = actor.size
    end = canvas.text((_MARGIN, 14), f"Track {actor.track_id} ({actor.category})", size=30)
    note = f"made by {actor.provenance.generator}; box {length:.2f} x {width:.2f} x {height:.2f} m"
    canvas.text((_MARGIN + end + 24, 24), note, palette.LOGGED, 20)
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
    canvas.text((_MARGIN, _MARGIN + crop.shape[0] + 6), seen, palette.LOGGED, _TEXT)
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
        _section("Source view", [*seen, *story.mask.warnings()]),
        _section("Registration", story.registration.explain().splitlines()),
        _section("Refinement", refined),
    ]
    if len(story.candidates) > 1:
        sections.insert(1, _table(story.candidates))
    return sections


def _section(title: str, sentences: Sequence[str]) -> list[_Line]:
    lines: list[_Line] = [[(0, title, palette.LOGGED)]]
    for sentence in sentences:
        first, *others = wrapped(sentence, _TEXT, _ROOM - 26)
        lines += [[(8, first, palette.TEXT)], *([(26, one, palette.TEXT)] for one in others)]
    return lines


def _table(candidates: Sequence[CandidateRecord]) -> list[_Line]:
    """The candidates with their scores; one that could not be made, with the reason."""
    lines: list[_Line] = [[(x, heading, palette.LOGGED) for heading, x in _CANDIDATES.items()]]
    places = list(_CANDIDATES.values())
    for one in candidates:
        generator, label, *scores = one.cells()
        room = places[3] if one.score is not None else _ROOM
        label, *more = wrapped(label, _TEXT, room - places[2] - 30)
        cells = ["chosen" if one.chosen else "", generator, label + ("\u2026" if more else "")]
        lines.append(
            [(x, cell, palette.TEXT) for x, cell in zip(places, [*cells, *scores], strict=True)]
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
    canvas = Canvas(_pixels(_WIDTH, 52), palette.GRID)
    x = _MARGIN
    for name, colour in palette.SHARES.items():
        label = f"{name} {getattr(mean, name):.0%}"
        x += _swatch(canvas, x, 26, label, colour, 21) + 40
    note = "of the vehicle in these eight views: seen in the log, mirrored from the seen side,"
    note += " or invented by the generator"
    canvas.text((x, 26), note, palette.LOGGED, _TEXT, "lm")
    return canvas.image


def _swatch(canvas: Canvas, x: int, y: int, label: str, colour: palette.Colour, size: int) -> int:
    """A square of the colour and its name, centred on `y`; the width of both."""
    half = size // 2
    canvas.image[y - half : y + half, x : x + 2 * half] = colour
    return 2 * half + 8 + canvas.text((x + 2 * half + 8, y), label, palette.TEXT, size, "lm")


def _labelled(picture: Image, label: str) -> Image:
    height, width = picture.shape[:2]
    canvas = Canvas(_pixels(width, height + 28))
    canvas.image[:height] = picture
    canvas.text((width / 2, height + 14), label, palette.TEXT, 16, "mm")
    return canvas.image


def _pixels(width: int, height: int) -> CanvasView:
    """A view that is only drawn on in pixels."""
    return CanvasView(np.zeros(2), 0.0, 1.0, width, height)
