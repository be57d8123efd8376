"""A run as one self-contained folder: `index.html` with its pictures and films, the truth first."""

from __future__ import annotations

import json
from collections.abc import Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from recast.actors.actor import Coverage
from recast.core.workers import usable_cores
from recast.logs.hdmap import HdMap
from recast.metrics import Agreement, AngleBin, OracleView, OracleViews, read_oracle_views
from recast.metrics.plan_agreement import (
    RECORDED,
    PlanAgreement,
    picture_path,
    read_agreement,
)
from recast.reporting import drawing, plots, summary, tables
from recast.reporting.birdseye import Birdseye, BirdseyeStyle, MapLayer
from recast.reporting.finding import endings, finding
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
from recast.reporting.moments import (
    camera_towards,
    filmed_cameras,
    moment_pictures,
    moment_strip,
)
from recast.reporting.page import Media, PageAssets, render_template, write_page
from recast.reporting.plots import Figure, Plot
from recast.reporting.previews import SIDES
from recast.reporting.summary import (
    checks,
    coverage_lines,
    coverage_note,
    looked_at,
    trust_note,
)
from recast.reporting.tables import TableCell, Tone
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
    pictured = {p.arm: _draw(p, driven[p.arm], assets, pool) for p in parts if p.arm in driven}
    curves = [
        plots.Curves(
            run.arms[p.arm],
            drawing.arm_colour(order[p.arm]),
            driven[p.arm].curves,
            None if isinstance(p.metrics, NotMade) else p.metrics.ttc.per_cycle,
        )
        for p in parts
        if p.arm in driven
    ]
    cameras = filmed_cameras(parts)
    joined = _joined(
        run, {arm: one["films"] for arm, one in pictured.items()}, cameras, assets, pool
    )
    covered = [p for p in parts if p.coverage is not None and p.arm in driven]
    end = max((float(one.curves.time[-1]) for one in driven.values()), default=0.0)
    strip = moment_strip(run, part.title, parts, driven, assets)
    times = [column.moment.time for column in strip.columns]
    columns = [
        {
            "title": run.arms[p.arm],
            "arm": order[p.arm],
            "drawn": {**pictured[p.arm], "birdseye": pictured[p.arm]["birdseye"].result()}
            if p.arm in pictured
            else NotMade(summary.why_missing(p.rollout)),
        }
        for p in parts
    ]
    compared = (summary.driving_note(part, run.arms), summary.truth_gaps(run, part))
    return {
        "part": part,
        "endings": endings(part, run.arms),
        "anchor": anchor,
        "columns": columns,
        "cameras": cameras,
        "camera": camera_towards(cameras, run.camera_headings),
        "joined": None if joined is None else (joined[0], joined[1].result()),
        "strip": strip,
        "lines": [_line(run, p, order[p.arm]) for p in parts],
        "plots": [
            *(plots.rollout_plots(curves, times) if curves else ()),
            *(_coverage_plot(run, p, end) for p in covered),
        ],
        "legend": [
            *((drawing.css(curve.colour), f"ego, {curve.label}") for curve in curves),
            (drawing.css(drawing.ACTOR), "actor"),
            ("currentColor", "ego as recorded (dotted)"),
            *((drawing.css(colour), name) for name, colour in drawing.SHARES.items() if covered),
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


_SUBTITLES = {
    "native": "from the log's images alone",
    "replaced": "completed by recast from the log's images",
    "oracle": "ground truth of the synthetic street",
}


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
    found = finding(run)
    pictures: list[tuple[str, Media | NotMade]] = []
    shares = None
    if found is not None and not isinstance(run.scenarios, NotMade):
        found.write(assets.folder)
        shares = _shares(run.scenarios[found.scenario])
        pictures = moment_pictures(run, run.scenarios[found.scenario].rollouts, found.step, assets)
    return render_template(
        "report.html",
        run=run,
        finding=found,
        pictures=pictures,
        subtitles={run.arms[arm]: text for arm, text in _SUBTITLES.items() if arm in run.arms},
        shares=shares,
        replay=assets.page("replay", run.replay) if isinstance(run.replay, Path) else run.replay,
        headline=summary.headline(run),
        checks=checks(run),
        outcomes=summary.outcomes(run),
        aggregate=aggregate,
        headings=tables.headings(() if isinstance(run.scenarios, NotMade) else run.scenarios),
        actor=_actor(run.actor, assets),
        coverage=()
        if isinstance(run.scenarios, NotMade)
        else coverage_lines(run.scenarios, run.arms),
        scenarios=scenarios,
        scene=_scene(run.scene, assets),
        recording=[
            agreement_view(read_agreement(folder), folder, assets.scoped(f"recording-{number}"))
            for number, folder in enumerate(run.recording)
        ],
        showcase=_showcase(run.showcase, assets),
        truth=truth_view(run.truth, assets) if isinstance(run.truth, TruthPart) else run.truth,
        nothing_on_truth=run.truth == NOT_MADE,
        config=_config(run.config),
    )


def _shares(scenario: ScenarioPart) -> Coverage | None:
    """What the images of a scenario showed of the vehicle; None without shares."""
    shown = [looked_at(p.coverage).mean for p in scenario.rollouts if p.coverage is not None]
    mean = Coverage.mean(shown)
    return mean if mean.pixels > 0 else None


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


def agreement_view(found: PlanAgreement, folder: Path, assets: PageAssets) -> dict[str, Any]:
    """What agreement.html shows.

    Args:
        folder: what `write_agreement` wrote: the pictures.
    """
    start_us = found.moments[0].timestamp_us
    labels = (RECORDED, *found.arms)
    names, rows = tables.agreement_cells(found)
    shown = [
        (
            f"{(one.timestamp_us - start_us) * 1e-6:.1f} s, {one.speed:.1f} m/s, {one.ahead}: "
            + ", ".join(f"{arm} {one.differences[arm].fde:.1f} m" for arm in found.arms),
            [
                (
                    label,
                    assets.photo(
                        f"{label}-{one.timestamp_us}",
                        picture_path(folder, one.timestamp_us, number),
                    ),
                )
                for number, label in enumerate(labels)
            ],
        )
        for one in found.worst()
    ]
    return {
        "found": found,
        "lead": tables.agreement_lead(found),
        "names": names,
        "rows": rows,
        "plot": plots.agreement_plot(found, start_us),
        "pictures": shown,
    }


def _config(config: Mapping[str, Any] | NotMade) -> str | NotMade:
    if isinstance(config, NotMade):
        return config
    return json.dumps(config, indent=2, default=str, ensure_ascii=False)


_LIMIT = 60.0  # degrees beyond which a view is one that the log never had
_BINS = ((0, 30), (30, 60), (60, 90), (90, 120), (120, 150), (150, 180.1))
_TITLES = {
    "mask_iou": ("Mask IoU with the truth", "mask IoU"),
    "psnr": ("PSNR inside the vehicle's box", "PSNR [dB]"),
}
_MEASURES: Mapping[str, tuple[str, int, str]] = {
    "psnr": ("PSNR", 1, "\u00a0dB"),
    "ssim": ("SSIM", 3, ""),
    "mask_iou": ("mask IoU", 2, ""),
    "sharpness": ("sharpness", 2, ""),
}
"""Field of `Agreement` to label, digits and unit."""
_NAMES = {"baseline": "street's own actor", "candidate": "generated actor", "truth": "truth"}
"""Where the run did not drive with one of them."""


def truth_plots(part: TruthPart) -> tuple[Plot, ...]:
    """One plot for each measure: a dot for each view, a line through the means of 30 degrees."""
    return tuple(_plot(part, measure, *words) for measure, words in _TITLES.items())


def _plot(part: TruthPart, measure: str, title: str, label: str) -> Plot:
    angles = np.array([view.angle for view in part.views.views])
    values = {
        arm: np.array([getattr(getattr(v, arm), measure) for v in part.views.views])
        for arm in part.colours
    }
    every = np.concatenate(list(values.values()))
    low, high = (0.0, 1.02) if measure == "mask_iou" else (every.min() - 1.0, every.max() + 1.0)
    horizontal = "angle from the nearest logged view [degrees]; shaded: 60 and more"
    figure = Figure(180.0, float(low), float(high), label, horizontal, 30.0)
    figure.band(_LIMIT, 180.0)
    told = []
    for arm, index in part.colours.items():
        colour = drawing.css(drawing.arm_colour(index))
        figure.dots(angles, values[arm], colour, 3.5, 0.55)
        members = [(angles >= first) & (angles < last) for first, last in _BINS]
        means = [(angles[m].mean(), values[arm][m].mean()) for m in members if m.any()]
        figure.line([at for at, _ in means], [mean for _, mean in means], colour, 2.6)
        beyond = values[arm][angles >= _LIMIT]
        if len(beyond):
            told.append(f"{part.names[arm]}: mean {beyond.mean():.2f} beyond {_LIMIT:.0f} degrees")
    return figure.plot(title, "; ".join(told) or title)


@dataclass(frozen=True)
class TruthLine:
    """One range of angles: how many views, and for each measure a cell an arm.

    The note of a cell is the paired difference with its interval.
    """

    label: str
    views: int
    cells: tuple[TableCell, ...]
    total: bool


@dataclass(frozen=True)
class TruthView:
    """The section, ready for the page.

    Attributes:
        lines: lines of the table; the last two gather the ones above.
        pictures: caption and picture of each view, the furthest from the log first.
    """

    part: TruthPart
    lines: tuple[TruthLine, ...]
    plots: tuple[Plot, ...]
    pictures: tuple[tuple[str, Media | NotMade], ...]


def truth_parts(
    folder: str | Path, arms: Mapping[str, str], *, baseline: str | None, candidate: str, truth: str
) -> tuple[ShowcasePart, TruthPart]:
    """First screen and section from the folder that `evaluate_oracle_views` wrote.

    Args:
        arms: arms as in `ReportInputs`, for names and colours.
        baseline: the one of `arms` that shows the street's own actor; None where none does.

    Raises:
        InputError: the folder's record is missing or broken.
    """
    folder = Path(folder)
    views = read_oracle_views(folder)
    keys = {"baseline": baseline, "candidate": candidate, "truth": truth}
    names = {side: arms.get(key or "", _NAMES[side]) for side, key in keys.items()}
    order = [*arms]
    colours = {
        side: order.index(key) if (key := keys[side]) in order else len(order)
        for side in ("baseline", "candidate")
    }
    pictures = {view.index: folder / view.picture for view in views.views}
    return _true_showcase(folder, views, names), TruthPart(views, names, colours, pictures)


def truth_view(part: TruthPart, assets: PageAssets) -> TruthView:
    """Copy the pictures and gather what the page says."""
    furthest_first = sorted(part.views.views, key=lambda view: (-view.angle, view.index))
    return TruthView(
        part=part,
        lines=tuple(_agreement_line(b) for b in part.views.summary if b.views),
        plots=truth_plots(part),
        pictures=tuple(
            (_caption(view), assets.photo(f"truth-{view.index:03d}", part.pictures[view.index]))
            for view in furthest_first
            if view.index in part.pictures
        ),
    )


def angle_label(low: float, high: float) -> str:
    """A range of degrees in words."""
    if high == 180.0:
        return "all views" if low == 0.0 else f"{low:.0f}° and more"
    return f"{low:.0f}° to {high:.0f}°"


def _true_showcase(folder: Path, views: OracleViews, names: Mapping[str, str]) -> ShowcasePart:
    view = next(v for v in views.views if v.index == views.showcase)
    side = SIDES[round(view.azimuth / 45) % 8]
    beyond = views.beyond_60
    numbers = ""
    if beyond.baseline is not None and beyond.candidate is not None:
        change = beyond.difference["mask_iou"]
        before, after = beyond.baseline, beyond.candidate
        numbers = (
            f"Over all {beyond.views} views 60° or more from the log, {names['baseline']} → "
            f"{names['candidate']}: PSNR {before.psnr:.1f} → {after.psnr:.1f}\u00a0dB, "
            f"mask IoU {before.mask_iou:.2f} → {after.mask_iou:.2f} ({change.point:+.2f}, "
            f"{100 * change.level:.0f} % interval {change.low:+.2f} to {change.high:+.2f})."
        )
    return ShowcasePart(
        caption=f"The target seen from its {side}, {view.distance:.0f} m ahead of the camera and "
        f"{view.angle:.0f}° away from the nearest of the {views.logged} recorded images that show "
        f"it. Camera and street are those of frame {view.frame} of the log.",
        pictures={name: folder / f"showcase_{key}.png" for key, name in names.items()},
        notes={
            names["baseline"]: _scores(view.baseline),
            names["candidate"]: _scores(view.candidate),
            names["truth"]: "rendered from the synthetic world of the log",
        },
        best=_better(view, names),
        numbers=numbers,
    )


def _better(view: OracleView, names: Mapping[str, str]) -> str | None:
    """The arm that is nearer to the truth in both PSNR and mask IoU."""
    baseline, candidate = view.baseline, view.candidate
    if candidate.psnr > baseline.psnr and candidate.mask_iou > baseline.mask_iou:
        return names["candidate"]
    if baseline.psnr > candidate.psnr and baseline.mask_iou > candidate.mask_iou:
        return names["baseline"]
    return None


def _agreement_line(angle_bin: AngleBin) -> TruthLine:
    cells: list[TableCell] = []
    assert angle_bin.baseline is not None and angle_bin.candidate is not None
    for measure, (_, digits, unit) in _MEASURES.items():
        baseline = getattr(angle_bin.baseline, measure)
        candidate = getattr(angle_bin.candidate, measure)
        change, better = angle_bin.difference[measure], angle_bin.candidate_better[measure]
        note = f"{change.point:+.{digits}f} ({change.low:+.{digits}f} to {change.high:+.{digits}f})"
        note += f", better in {better} of {angle_bin.views}"
        for value, other, remark in ((baseline, candidate, None), (candidate, baseline, note)):
            tone: Tone = "good" if value > other else "plain"
            cells.append(TableCell(f"{value:.{digits}f}{unit}", tone, remark))
    low, high = angle_bin.low, angle_bin.high
    total = (low, high) in ((60.0, 180.0), (0.0, 180.0))
    return TruthLine(angle_label(low, high), angle_bin.views, tuple(cells), total)


def _caption(view: OracleView) -> str:
    side = SIDES[round(view.azimuth / 45) % 8]
    known = "" if view.coverage is None else f", {view.coverage.invented:.0%} of it invented"
    return (
        f"{view.angle:.0f}° from the log, {side} at {view.distance:.0f} m{known}: "
        f"mask IoU {view.baseline.mask_iou:.2f} and {view.candidate.mask_iou:.2f}, "
        f"PSNR {view.baseline.psnr:.1f} and {view.candidate.psnr:.1f} dB"
    )


def _scores(score: Agreement) -> str:
    return ", ".join(
        f"{label} {getattr(score, measure):.{digits}f}{unit}"
        for measure, (label, digits, unit) in _MEASURES.items()
    )
