"""One scenario as the page shows it: films, pictures, curves and numbers of every arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from recast.logs.hdmap import HdMap
from recast.reporting import birdseye, drives_compared, palette, plots, summary, tables
from recast.reporting.assets import Assets, Media
from recast.reporting.coverage_view import coverage_lines, coverage_note, looked_at
from recast.reporting.inputs import ActorPart, NotMade, ReportInputs, RolloutPart, ScenarioPart
from recast.reporting.series import Series, series
from recast.simulation.rollout import Rollout


@dataclass(frozen=True)
class Drawn:
    """What there is to see of a rollout that came about."""

    films: Mapping[str, Media | NotMade] | NotMade
    birdseye: Media | NotMade
    still: Media | NotMade
    events: tuple[summary.Event, ...]


@dataclass(frozen=True)
class MethodColumn:
    """One arm's part of a player; `arm` is the index of its colour."""

    title: str
    arm: int
    drawn: Drawn | NotMade


@dataclass(frozen=True)
class ScenarioView:
    """One scenario, ready for the page.

    Attributes:
        part: its title and description.
        anchor: its id in the page.
        columns: one an arm.
        cameras: all that some arm has a film of.
        joined: camera and arms in words, and the film with the two side by side.
        lines: of the metric table, one an arm.
        legend: colour and meaning of the curves in `plots`, and of their areas.
        seconds: the length of the longest rollout; `dt` between states.
        notes: sentences on how the arms compare: who drove alike, and how far from the truth;
            and on what was shown of the actor.
    """

    part: ScenarioPart
    anchor: str
    columns: tuple[MethodColumn, ...]
    cameras: tuple[str, ...]
    joined: tuple[tuple[str, Media | NotMade], ...]
    lines: tuple[tables.Line, ...]
    plots: tuple[plots.Plot, ...]
    legend: tuple[tuple[str, str], ...]
    seconds: float
    dt: float
    notes: tuple[str, ...]


def scenario_view(
    run: ReportInputs, part: ScenarioPart, anchor: str, assets: Assets
) -> ScenarioView:
    """Write a scenario's films and pictures and gather what the page says about it."""
    order = {arm: i for i, arm in enumerate(run.arms)}
    parts = sorted(part.rollouts, key=lambda rollout: order[rollout.arm])
    driven = {p.arm: series(p.rollout) for p in parts if isinstance(p.rollout, Rollout)}
    columns = tuple(
        MethodColumn(
            run.arms[p.arm],
            order[p.arm],
            _draw(run, part, p, driven[p.arm], assets)
            if p.arm in driven
            else NotMade(summary.why_missing(p.rollout)),
        )
        for p in parts
    )
    curves = [
        plots.Curves(
            run.arms[p.arm],
            palette.arm_colour(order[p.arm]),
            driven[p.arm],
            None if isinstance(p.metrics, NotMade) else p.metrics.ttc.per_cycle,
        )
        for p in parts
        if p.arm in driven
    ]
    cameras = dict.fromkeys(
        name for p in parts if not isinstance(p.films, NotMade) for name in p.films
    )
    covered = [p for p in parts if p.coverage is not None and p.arm in driven]
    steps = [p.rollout.dt for p in parts if isinstance(p.rollout, Rollout)]
    return ScenarioView(
        part=part,
        anchor=anchor,
        columns=columns,
        cameras=tuple(cameras),
        joined=_joined(run, part, columns, tuple(cameras), assets),
        lines=tuple(_line(run, p, order[p.arm]) for p in parts),
        plots=(
            *(plots.rollout_plots(anchor, curves) if curves else ()),
            *(_coverage_plot(run, anchor, p, driven) for p in covered),
        ),
        legend=(
            *((palette.css(curve.colour), f"ego, {curve.label}") for curve in curves),
            (palette.css(palette.ACTOR), "actor"),
            ("currentColor", "ego as recorded (dotted)"),
            *((palette.css(colour), name) for name, colour in palette.SHARES.items() if covered),
        ),
        seconds=max((float(c.time[-1]) for c in driven.values()), default=0.0),
        dt=steps[0] if steps else 0.1,
        notes=tuple(
            note
            for note in (
                drives_compared.driving_note(part, run.arms),
                drives_compared.truth_gaps(run, part),
            )
            if note is not None
        )
        + tuple(coverage_note(line) for line in coverage_lines([part], run.arms)),
    )


def _coverage_plot(
    run: ReportInputs, anchor: str, part: RolloutPart, driven: Mapping[str, Series]
) -> plots.Plot:
    assert part.coverage is not None and isinstance(part.rollout, Rollout)
    end = max(float(curves.time[-1]) for curves in driven.values())
    return plots.coverage_plot(
        f"{anchor}-coverage-{part.arm}", run.arms[part.arm], looked_at(part.coverage),
        part.rollout.dt, end,
    )  # fmt: skip


def _draw(
    run: ReportInputs, scenario: ScenarioPart, part: RolloutPart, curves: Series, assets: Assets
) -> Drawn | NotMade:
    rollout = part.rollout
    assert isinstance(rollout, Rollout)
    name = f"{scenario.title}-{part.arm}"
    hd_map = run.hd_map if isinstance(run.hd_map, HdMap) else None
    log_path = run.actor.log_path if isinstance(run.actor, ActorPart) else None
    films = part.films
    return Drawn(
        films=films
        if isinstance(films, NotMade)
        else {camera: assets.film(f"{name}-{camera}", film) for camera, film in films.items()},
        birdseye=assets.draw_film(
            f"{name}-birdseye", birdseye.draw_frames(rollout, hd_map, log_path), 1.0 / rollout.dt
        ),
        still=assets.picture(f"{name}-birdseye", birdseye.draw_still(rollout, hd_map, log_path)),
        events=summary.rollout_events(part, curves),
    )


def _line(run: ReportInputs, part: RolloutPart, arm: int) -> tables.Line:
    title = run.arms[part.arm]
    if not isinstance(part.metrics, NotMade):
        line = tables.rollout_line(title, arm, part.metrics)
        return tables.untoned(line) if part.arm == run.truth_arm else line
    reason = part.metrics.reason
    if not isinstance(part.rollout, Rollout):
        reason = summary.why_missing(part.rollout)
    return tables.missing_line(title, arm, reason)


def _joined(
    run: ReportInputs,
    part: ScenarioPart,
    columns: tuple[MethodColumn, ...],
    cameras: tuple[str, ...],
    assets: Assets,
) -> tuple[tuple[str, Media | NotMade], ...]:
    """For each camera, each arm beside the first one, and beside the truth where there is one:
    films to pass on outside of the page."""
    truth = None if run.truth_arm is None else run.arms[run.truth_arm]
    joined = []
    for camera in cameras:
        found = {
            column.title: film
            for column in columns
            if isinstance(column.drawn, Drawn)
            and not isinstance(column.drawn.films, NotMade)
            and isinstance(film := column.drawn.films.get(camera), Media)
        }
        first, *others = [title for title in found if title != truth] or [""]
        pairs = [(first, other) for other in others]
        if truth in found:
            pairs += [(other, truth) for other in (others or [first]) if other]
        for left, right in pairs:
            name = f"{part.title}-{camera}-{left}-beside-{right}"
            film = assets.joined_film(name, found[left], found[right], (left, right))
            joined.append((f"{camera}, {left} and {right}", film))
    return tuple(joined)
