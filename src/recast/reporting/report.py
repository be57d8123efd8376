"""A run as one self-contained folder: `index.html` with its pictures and films."""

from __future__ import annotations

import json
from collections.abc import Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from recast.core.workers import usable_cores
from recast.logs.hdmap import HdMap
from recast.reporting import palette, plots, summary, tables
from recast.reporting.birdseye import Birdseye, BirdseyeStyle, MapLayer
from recast.reporting.inputs import (
    NOT_MADE,
    ActorPart,
    NotMade,
    ObservationPart,
    ReportInputs,
    RolloutPart,
    ScenarioPart,
    ScenePart,
    ShowcasePart,
    TruthPart,
)
from recast.reporting.moments import camera_towards, filmed_cameras, moment_strip
from recast.reporting.page import Media, PageAssets, render_template, write_page
from recast.reporting.summary import (
    checks,
    coverage_lines,
    coverage_note,
    glance,
    looked_at,
    trust_note,
)
from recast.reporting.truth import truth_view
from recast.simulation.rollout import Rollout


def _scenario(
    run: ReportInputs,
    layer: MapLayer,
    pool: Executor,
    part: ScenarioPart,
    anchor: str,
    assets: PageAssets,
) -> dict[str, Any]:
    """Write a scenario's videos and images and gather what scenario.html says about it.

    Args:
        pool: pool of threads that encode its videos meanwhile.
    """
    order = {arm: i for i, arm in enumerate(run.arms)}
    parts = sorted(part.rollouts, key=lambda rollout: order[rollout.arm])
    log_path = run.actor.log_path if isinstance(run.actor, ActorPart) else None
    driven = {
        p.arm: Birdseye(p.rollout, layer, log_path) for p in parts if isinstance(p.rollout, Rollout)
    }
    # Videos are encoded meanwhile: `birdseye` and `joined` are asked for last.
    drawing = {p.arm: _draw(p, driven[p.arm], assets, pool) for p in parts if p.arm in driven}
    curves = [
        plots.Curves(
            run.arms[p.arm],
            palette.arm_colour(order[p.arm]),
            driven[p.arm].curves,
            None if isinstance(p.metrics, NotMade) else p.metrics.ttc.per_cycle,
        )
        for p in parts
        if p.arm in driven
    ]
    cameras = filmed_cameras(parts)
    joined = _joined(
        run, {arm: one["films"] for arm, one in drawing.items()}, cameras, assets, pool
    )
    covered = [p for p in parts if p.coverage is not None and p.arm in driven]
    end = max((float(one.curves.time[-1]) for one in driven.values()), default=0.0)
    strip = moment_strip(run, part.title, parts, driven, assets)
    times = [column.moment.time for column in strip.columns]
    columns = [
        {
            "title": run.arms[p.arm],
            "arm": order[p.arm],
            "drawn": {**drawing[p.arm], "birdseye": drawing[p.arm]["birdseye"].result()}
            if p.arm in drawing
            else NotMade(summary.why_missing(p.rollout)),
        }
        for p in parts
    ]
    compared = (summary.driving_note(part, run.arms), summary.truth_gaps(run, part))
    return {
        "part": part,
        "anchor": anchor,
        "columns": columns,
        "cameras": cameras,
        "joined": None if joined is None else (joined[0], joined[1].result()),
        "strip": strip,
        "lines": [_line(run, p, order[p.arm]) for p in parts],
        "plots": [
            *(plots.rollout_plots(curves, times) if curves else ()),
            *(_coverage_plot(run, p, end) for p in covered),
        ],
        "legend": [
            *((palette.css(curve.colour), f"ego, {curve.label}") for curve in curves),
            (palette.css(palette.ACTOR), "actor"),
            ("currentColor", "ego as recorded (dotted)"),
            *((palette.css(colour), name) for name, colour in palette.SHARES.items() if covered),
        ],
        "seconds": end,
        "dt": next((one.rollout.dt for one in driven.values()), 0.1),
        "notes": [
            *(note for note in compared if note is not None),
            *(coverage_note(line) for line in coverage_lines([part], run.arms)),
            *(trust_note(p, run.arms) for p in parts if p.trust is not None),
        ],
    }


def _coverage_plot(run: ReportInputs, part: RolloutPart, end: float) -> plots.Plot:
    assert part.coverage is not None and isinstance(part.rollout, Rollout)
    return plots.coverage_plot(run.arms[part.arm], looked_at(part.coverage), part.rollout.dt, end)


def _draw(part: RolloutPart, drawn: Birdseye, assets: PageAssets, pool: Executor) -> dict[str, Any]:
    """What there is to see of a rollout that came about; `birdseye` is still being encoded."""
    films, style, rollout = part.films, BirdseyeStyle(), drawn.rollout
    frames = (drawn.frame(step, style) for step in range(rollout.steps_run + 1))
    return {
        "films": films
        if isinstance(films, NotMade)
        else {camera: assets.film(f"{part.arm}-{camera}", film) for camera, film in films.items()},
        "birdseye": assets.draw_film(f"{part.arm}-birdseye", frames, 1.0 / rollout.dt, pool),
        "still": assets.picture(f"{part.arm}-birdseye", drawn.still(style)),
        "events": summary.rollout_events(part, drawn.curves),
    }


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
    filmed: Mapping[str, Mapping[str, Media | NotMade] | NotMade],
    cameras: tuple[str, ...],
    assets: PageAssets,
    pool: Executor,
) -> tuple[str, Future[Media | NotMade]] | None:
    """A film to pass on outside of the page: all arms beside each other, looking ahead.

    Args:
        filmed: films of each arm, by arm and camera.
    """
    camera = camera_towards(cameras, run.camera_headings)
    films = [
        (run.arms[arm], film)
        for arm, own in filmed.items()
        if not isinstance(own, NotMade) and isinstance(film := own.get(camera or ""), Media)
    ]
    if camera is None or len(films) < 2:
        return None
    return camera, assets.joined_film(f"{camera}-side-by-side", films, pool)


def write_report(run: ReportInputs, out: str | Path) -> Path:
    """Write the report folder and return its `index.html`.

    The folder holds everything the page shows and asks for nothing from the network. It appears
    whole; an earlier report at `out` is replaced. The same inputs give the same bytes.

    Raises:
        InputError: `out` holds something that is no report, or the disk is full.
        ValueError: `run` contradicts itself.
    """
    run.validate()
    return write_page(out, lambda assets: _render(run, assets))


def _render(run: ReportInputs, assets: PageAssets) -> str:
    scenarios: list[dict[str, Any]] | NotMade
    if isinstance(run.scenarios, NotMade):
        scenarios = run.scenarios
        aggregate: tuple[tables.Line, ...] = ()
    else:
        layer = MapLayer(run.hd_map if isinstance(run.hd_map, HdMap) else None)
        scopes = [assets.scoped(part.title) for part in run.scenarios]
        anchors = [f"scenario-{number}" for number in range(1, len(scopes) + 1)]
        cores = usable_cores()  # films are encoded without Python's lock
        with ThreadPoolExecutor(cores) as encoders, ThreadPoolExecutor(cores) as pool:
            view = partial(_scenario, run, layer, encoders)
            scenarios = list(pool.map(view, run.scenarios, anchors, scopes))
        aggregate = tables.aggregate_lines(run.scenarios, run.arms, run.truth_arm)
    made = checks(run)
    return render_template(
        "report.html",
        run=run,
        glance=glance(run, made),
        replay=assets.page("replay", run.replay) if isinstance(run.replay, Path) else run.replay,
        headline=summary.headline(run),
        checks=made,
        outcomes=summary.outcomes(run),
        aggregate=aggregate,
        actor=_actor(run.actor, assets),
        coverage=()
        if isinstance(run.scenarios, NotMade)
        else coverage_lines(run.scenarios, run.arms),
        scenarios=scenarios,
        scene=_scene(run.scene, assets),
        showcase=_showcase(run.showcase, assets),
        truth=truth_view(run.truth, assets) if isinstance(run.truth, TruthPart) else run.truth,
        nothing_on_truth=run.truth == NOT_MADE,
        config=_config(run.config),
    )


def _showcase(showcase: ShowcasePart | NotMade, assets: PageAssets) -> dict[str, Any] | NotMade:
    if isinstance(showcase, NotMade):
        return showcase
    pictures = [
        (label, assets.picture(f"showcase-{label}", picture))
        for label, picture in showcase.pictures.items()
    ]
    return {"part": showcase, "pictures": pictures}


def _actor(actor: ActorPart | NotMade, assets: PageAssets) -> dict[str, Any] | NotMade:
    if isinstance(actor, NotMade):
        return actor
    seen = actor.observation
    if isinstance(seen, NotMade):
        seen = ObservationPart(crop=seen, frame=seen)
    return {
        "part": actor,
        "crop": assets.picture("actor-crop", seen.crop),
        "frame": assets.photo("actor-frame", seen.frame),
        "facts": seen.facts,
        "turntable": assets.film("actor-turntable", actor.turntable),
        "all_around": assets.photo("actor-all-around", actor.all_around),
        "registration": actor.registration,
    }


def _scene(scene: ScenePart | NotMade, assets: PageAssets) -> dict[str, Any] | NotMade:
    if isinstance(scene, NotMade):
        return scene
    comparisons = [
        (
            comparison.caption,
            [
                (label, assets.photo(f"scene-{i + 1}-{label}", picture))
                for label, picture in comparison.pictures.items()
            ],
        )
        for i, comparison in enumerate(scene.comparisons)
    ]
    return {"part": scene, "comparisons": comparisons}


def _config(config: Mapping[str, Any] | NotMade) -> str | NotMade:
    if isinstance(config, NotMade):
        return config
    return json.dumps(config, indent=2, default=str, ensure_ascii=False)
