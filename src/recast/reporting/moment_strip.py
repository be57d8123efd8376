"""The strip of a scenario: each moment at which its arms part, as a camera of every arm saw it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.core.errors import InputError
from recast.reporting import palette
from recast.reporting.birdseye import Birdseye, BirdseyeStyle
from recast.reporting.canvas import at_width
from recast.reporting.inputs import NotMade, ReportInputs, RolloutPart
from recast.reporting.moments import Moment, find_moments
from recast.reporting.page import Media, PageAssets
from recast.reporting.tables import Tone
from recast.reporting.video import film_frames
from recast.simulation.rollout import Rollout

_WIDTH, _HEIGHT = 560, 224  # of a bird's-eye view, pixels
_NEAREST, _FURTHEST = 36.0, 110.0  # metres across it
_BEHIND, _AHEAD = 0.28, 12.0  # share of it behind the ego, and metres beyond the actor
_BESIDE = 0.3  # metres; an outline nearer to the ego would look like the mark of a contact
_WIDEST = 640  # pixels, of a camera image


def filmed_cameras(parts: Iterable[RolloutPart]) -> tuple[str, ...]:
    """Names of all cameras that some rollout has a film of, in the order of the films."""
    return tuple(
        dict.fromkeys(
            name for part in parts if not isinstance(part.films, NotMade) for name in part.films
        )
    )


def camera_towards(
    names: Iterable[str], headings: Mapping[str, float], bearing: float = 0.0
) -> str | None:
    """The camera whose heading is nearest to a bearing; the first if no heading is known.

    Args:
        names: names of the cameras to choose among; None is returned if there are none.
        headings: headings in radians by name, 0 ahead, positive to the left.
        bearing: bearing in radians, likewise.
    """

    def away(name: str) -> float:
        if name not in headings:
            return np.inf
        return abs(float(np.angle(np.exp(1j * (headings[name] - bearing)))))

    return min(names, key=away, default=None)


@dataclass(frozen=True)
class MomentCell:
    """One arm at one moment: what a camera saw, the view from above, and the numbers."""

    camera: Media | NotMade
    birdseye: Media | NotMade
    note: str
    tone: Tone


@dataclass(frozen=True)
class MomentColumn:
    """One moment.

    Attributes:
        camera: name of the camera whose images are shown; None without films.
        cells: one cell for each arm, in the order of `Strip.arms`.
    """

    moment: Moment
    camera: str | None
    cells: tuple[MomentCell, ...]


@dataclass(frozen=True)
class Strip:
    """All moments of a scenario; `arms` are indices of `ReportInputs.arms`."""

    arms: tuple[int, ...]
    columns: tuple[MomentColumn, ...]


def moment_strip(
    run: ReportInputs,
    name: str,
    parts: Sequence[RolloutPart],
    drawn: Mapping[str, Birdseye],
    assets: PageAssets,
) -> Strip:
    """Find the moments of a scenario and write their pictures.

    Args:
        parts: its rollouts, in the order of `run.arms`.
        drawn: rollouts made ready to be drawn, by arm.
    """
    moments = find_moments(parts, run.arms)
    driven = [part for part in parts if part.arm in drawn]
    order = list(run.arms)
    cameras = [_camera(run, driven, moment.step) for moment in moments]
    images = {part.arm: _images(part, moments, cameras) for part in driven}
    columns = []
    for number, (moment, camera) in enumerate(zip(moments, cameras, strict=True), 1):
        style = _style([part.rollout for part in driven], moment.step)
        cells = []
        for part in driven:
            file = f"{name}-moment-{number}-{part.arm}"
            if moment.step > drawn[part.arm].rollout.steps_run:
                ended = NotMade(f"this rollout ended at {drawn[part.arm].curves.time[-1]:.1f} s")
                cells.append(MomentCell(ended, ended, "", "plain"))
                continue
            others = _others(run, drawn, part.arm, moment.step)
            cells.append(
                MomentCell(
                    assets.photo(f"{file}-camera", images[part.arm][number - 1]),
                    assets.picture(file, drawn[part.arm].frame(moment.step, style, others)),
                    *_note(drawn[part.arm], moment.step),
                )
            )
        columns.append(MomentColumn(moment, camera, tuple(cells)))
    return Strip(tuple(order.index(part.arm) for part in driven), tuple(columns))


def _camera(run: ReportInputs, driven: Sequence[RolloutPart], step: int) -> str | None:
    """The camera with a film that looks most nearly at the actor, as the first arm has it."""
    rollout = driven[0].rollout
    assert isinstance(rollout, Rollout)
    step = min(step, rollout.steps_run)
    x, y = rollout.actor[step, :2] - rollout.ego[step, :2]
    bearing = float(np.arctan2(y, x) - rollout.ego[step, 2])
    return camera_towards(filmed_cameras(driven), run.camera_headings, bearing)


def _images(
    part: RolloutPart, moments: Sequence[Moment], cameras: Sequence[str | None]
) -> list[NDArray[np.uint8] | NotMade]:
    """An arm's camera image of each moment."""
    films = {} if isinstance(part.films, NotMade) else part.films
    found: dict[tuple[str, int], NDArray[np.uint8] | NotMade] = {}
    for name in dict.fromkeys(cameras):
        if name is None or name not in films:
            continue
        steps = [m.step for m, camera in zip(moments, cameras, strict=True) if camera == name]
        try:
            frames = film_frames(films[name], steps)
            found.update(
                {
                    (name, step): at_width(frame, min(_WIDEST, frame.shape[1]))
                    for step, frame in frames.items()
                }
            )
        except InputError as error:
            reason = NotMade(f"{films[name].name} {error.problem}")
            found.update({(name, step): reason for step in steps})
    missing = NotMade("no camera was recorded on video")
    return [
        found.get((name or "", moment.step), missing)
        for moment, name in zip(moments, cameras, strict=True)
    ]


def _style(rollouts: Sequence[object], step: int) -> BirdseyeStyle:
    """The same scale for all arms of a moment: the actor is in each picture, if it is near."""
    reach = 0.0
    for rollout in rollouts:
        assert isinstance(rollout, Rollout)
        at = min(step, rollout.steps_run)
        reach = max(reach, float(np.hypot(*(rollout.actor[at, :2] - rollout.ego[at, :2]))))
    span = float(np.clip((reach + _AHEAD) / (1 - _BEHIND), _NEAREST, _FURTHEST))
    return BirdseyeStyle(film_width=_WIDTH, film_height=_HEIGHT, span=span, words=False)


def _others(
    run: ReportInputs, drawn: Mapping[str, Birdseye], arm: str, step: int
) -> list[tuple[NDArray[np.float64], palette.Colour]]:
    """Egos of other arms that are elsewhere, in the colours of their arms."""
    order, here = list(run.arms), drawn[arm].rollout.ego[step, :2]
    return [
        (one.rollout.ego_boxes[step], palette.arm_colour(order.index(other)))
        for other, one in drawn.items()
        if other != arm
        and step <= one.rollout.steps_run
        and np.hypot(*(one.rollout.ego[step, :2] - here)) > _BESIDE
    ]


def _note(drawn: Birdseye, step: int) -> tuple[str, Tone]:
    curves = drawn.curves
    speed = f"ego {curves.ego_speed[step]:.1f} m/s"
    if curves.contact[step]:
        return f"contact, {speed}", "bad"
    return f"gap {curves.gap[step]:.1f} m, {speed}", "plain"
