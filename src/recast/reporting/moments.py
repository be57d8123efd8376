"""The moments of a scenario at which its arms part, and the strip of what each arm's camera saw."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from recast.core.errors import InputError
from recast.metrics.driving import CAP
from recast.reporting import drawing
from recast.reporting.birdseye import Birdseye, BirdseyeStyle
from recast.reporting.drawing import at_width
from recast.reporting.inputs import NotMade, ReportInputs, RolloutPart
from recast.reporting.page import Media, PageAssets
from recast.reporting.plots import first_true, planned_paths, series
from recast.reporting.summary import listed
from recast.reporting.tables import Tone
from recast.reporting.video import film_frames
from recast.simulation.rollout import Rollout

PATHS_APART = 0.5
"""Metres between the egos of two arms from which on their paths count as parted."""
PLANS_APART = 1.0
"""Metres between two plans of the same step, at the same waypoint, from which on they differ."""


@dataclass(frozen=True)
class Moment:
    """A moment of a scenario: step of the rollouts, seconds from their start, why it is shown."""

    step: int
    time: float
    reasons: tuple[str, ...]


def find_moments(parts: Sequence[RolloutPart], arms: Mapping[str, str]) -> tuple[Moment, ...]:
    """Moments of one scenario, by time.

    These are the first step at which two arms' plans, and two arms' ego positions, are more than
    `PLANS_APART` and `PATHS_APART` apart; the first contact; the first departure from the road; and
    the plan with the least time to collision of those made before its arm's first contact, if that
    time is below 4 s. If there is none of these, it is the moment of the smallest gap. Reasons at
    the same step are one moment.

    Args:
        parts: rollouts of the scenario; those that did not come about are left out.
    """
    driven = {part.arm: part for part in parts if isinstance(part.rollout, Rollout)}
    if not driven:
        return ()
    rollouts = {arm: p.rollout for arm, p in driven.items() if isinstance(p.rollout, Rollout)}
    found = [
        *_earliest("the plans diverge", _plans_part(rollouts), arms),
        *_earliest("the paths diverge", _paths_part(rollouts), arms),
        *_first("contact", {arm: _contact(part) for arm, part in driven.items()}, arms),
        *_first("off the road", {arm: _off(part) for arm, part in driven.items()}, arms),
        *_worst_plan(driven, arms),
    ]
    if not found:
        found = _smallest_gap(rollouts, arms)
    dt = next(iter(rollouts.values())).dt
    reasons: dict[int, list[str]] = {}
    for step, words in found:
        reasons.setdefault(step, []).append(words)
    return tuple(
        Moment(step, round(step * dt, 6), tuple(reasons[step])) for step in sorted(reasons)
    )


_Found = list[tuple[int, str]]
"""Steps, and why each is a moment."""


def paths_part(one: Rollout, other: Rollout) -> int | None:
    """First step at which two egos are more than `PATHS_APART` apart; None if they never are."""
    steps = min(len(one.ego), len(other.ego))
    away = np.hypot(*(one.ego[:steps, :2] - other.ego[:steps, :2]).T)
    return first_true(away > PATHS_APART)


def _paths_part(rollouts: Mapping[str, Rollout]) -> dict[tuple[str, str], int]:
    pairs = combinations(rollouts, 2)
    steps = {(one, other): paths_part(rollouts[one], rollouts[other]) for one, other in pairs}
    return {pair: step for pair, step in steps.items() if step is not None}


def _plans_part(rollouts: Mapping[str, Rollout]) -> dict[tuple[str, str], int]:
    firsts = {}
    paths = {arm: planned_paths(rollout) for arm, rollout in rollouts.items()}
    for (one, first), (other, second) in combinations(rollouts.items(), 2):
        shared = min(len(first.plan_steps), len(second.plan_steps))
        same = first.plan_steps[:shared] == second.plan_steps[:shared]
        away = np.linalg.norm(paths[one][:shared] - paths[other][:shared], axis=-1).max(axis=1)
        beyond = first_true(same & (away > PLANS_APART))
        if beyond is not None:
            firsts[one, other] = int(first.plan_steps[beyond])
    return firsts


def _earliest(words: str, firsts: Mapping[tuple[str, str], int], arms: Mapping[str, str]) -> _Found:
    if not firsts:
        return []
    one, other = min(firsts, key=lambda pair: firsts[pair])
    return [(firsts[one, other], f"{words}: {arms[one]} and {arms[other]}")]


def _first(words: str, steps: Mapping[str, int | None], arms: Mapping[str, str]) -> _Found:
    known = {arm: step for arm, step in steps.items() if step is not None}
    if not known:
        return []
    first = min(known.values())
    titles = [arms[arm] for arm, step in known.items() if step == first]
    return [(first, f"{words}: {listed(titles)}")]


def _contact(part: RolloutPart) -> int | None:
    assert isinstance(part.rollout, Rollout)
    if isinstance(part.metrics, NotMade):
        return series(part.rollout).collision_step
    return part.metrics.collision.first_step


def _off(part: RolloutPart) -> int | None:
    return None if isinstance(part.metrics, NotMade) else part.metrics.drivable.first_step


def _worst_plan(parts: Mapping[str, RolloutPart], arms: Mapping[str, str]) -> _Found:
    worst: tuple[float, int, str] | None = None
    for arm, part in parts.items():
        if isinstance(part.metrics, NotMade):
            continue
        hit = _contact(part)
        before = len([step for step in part.metrics.plan_steps if hit is None or step < hit])
        times = part.metrics.ttc.per_cycle[:before]
        if len(times) == 0:
            continue
        plan = int(np.argmin(times))
        if times[plan] < CAP and (worst is None or times[plan] < worst[0]):
            worst = float(times[plan]), part.metrics.plan_steps[plan], arms[arm]
    if worst is None:
        return []
    return [(worst[1], f"worst plan, meets the actor after {worst[0]:.1f} s: {worst[2]}")]


def _smallest_gap(rollouts: Mapping[str, Rollout], arms: Mapping[str, str]) -> _Found:
    gaps = {arm: series(rollout).gap for arm, rollout in rollouts.items()}
    arm = min(gaps, key=lambda key: float(gaps[key].min()))
    return [(int(np.argmin(gaps[arm])), f"smallest gap, {gaps[arm].min():.1f} m: {arms[arm]}")]


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


def moment_pictures(
    run: ReportInputs, parts: Sequence[RolloutPart], step: int, assets: PageAssets
) -> list[tuple[str, Media | NotMade]]:
    """What the camera that looks at the actor saw at a step, by the label of the arm.

    Args:
        parts: rollouts of a scenario; those without a rollout are left out.
    """
    driven = sorted(
        (part for part in parts if isinstance(part.rollout, Rollout)),
        key=lambda part: list(run.arms).index(part.arm),
    )
    if not driven:
        return []
    moment, camera = Moment(step, 0.0, ()), _camera(run, driven, step)
    images = {part.arm: _images(part, [moment], [camera])[0] for part in driven}
    return [(run.arms[arm], assets.photo(f"finding-{arm}", image)) for arm, image in images.items()]


def _camera(run: ReportInputs, driven: Sequence[RolloutPart], step: int) -> str | None:
    """The camera with a film that looks most nearly at the actor, as the first arm has it."""
    rollout = driven[0].rollout
    assert isinstance(rollout, Rollout)
    bearing = float(actor_bearings(rollout)[min(step, rollout.steps_run)])
    return camera_towards(filmed_cameras(driven), run.camera_headings, bearing)


def actor_bearings(rollout: Rollout) -> NDArray[np.float64]:
    """Radians (S+1,) from the ego's heading to the actor, left positive; not wrapped."""
    x, y = (rollout.actor[:, :2] - rollout.ego[:, :2]).T
    return np.arctan2(y, x) - rollout.ego[:, 2]


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
) -> list[tuple[NDArray[np.float64], drawing.Colour]]:
    """Egos of other arms that are elsewhere, in the colours of their arms."""
    order, here = list(run.arms), drawn[arm].rollout.ego[step, :2]
    return [
        (one.rollout.ego_boxes[step], drawing.arm_colour(order.index(other)))
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
