"""A run as one self-contained folder: `index.html` with its pictures and films."""

from __future__ import annotations

import json
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from recast.core.workers import usable_cores
from recast.logs.hdmap import HdMap
from recast.reporting import summary, tables
from recast.reporting.checks import checks, coverage_lines, glance
from recast.reporting.inputs import (
    NOT_MADE,
    ActorPart,
    NotMade,
    ObservationPart,
    ReportInputs,
    ScenePart,
    ShowcasePart,
    TruthPart,
)
from recast.reporting.marks import MapLayer
from recast.reporting.page import Assets, render_template, write_page
from recast.reporting.scenario_view import ScenarioView, scenario_view
from recast.reporting.truth import truth_view


def write_report(run: ReportInputs, out: str | Path) -> Path:
    """Write the report folder and return its `index.html`.

    The folder holds everything the page shows and asks for nothing from the network. It appears
    whole; an earlier report at `out` is replaced. The same inputs give the same bytes.

    Args:
        run: what to show; see `ReportInputs`.
        out: the folder.

    Raises:
        InputError: `out` holds something that is no report, or the disk is full.
        ValueError: `run` contradicts itself.
    """
    run.validate()
    return write_page(out, lambda assets: _render(run, assets))


def _render(run: ReportInputs, assets: Assets) -> str:
    scenarios: tuple[ScenarioView, ...] | NotMade
    if isinstance(run.scenarios, NotMade):
        scenarios = run.scenarios
        aggregate: tuple[tables.Line, ...] = ()
    else:
        layer = MapLayer(run.hd_map if isinstance(run.hd_map, HdMap) else None)
        scopes = [assets.scoped(part.title) for part in run.scenarios]
        anchors = [f"scenario-{number}" for number in range(1, len(scopes) + 1)]
        with ThreadPoolExecutor(usable_cores()) as pool:  # films are encoded without Python's lock
            scenarios = tuple(
                pool.map(partial(scenario_view, run, layer), run.scenarios, anchors, scopes)
            )
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


def _showcase(showcase: ShowcasePart | NotMade, assets: Assets) -> dict[str, Any] | NotMade:
    if isinstance(showcase, NotMade):
        return showcase
    pictures = [
        (label, assets.picture(f"showcase-{label}", picture))
        for label, picture in showcase.pictures.items()
    ]
    return {"part": showcase, "pictures": pictures}


def _actor(actor: ActorPart | NotMade, assets: Assets) -> dict[str, Any] | NotMade:
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


def _scene(scene: ScenePart | NotMade, assets: Assets) -> dict[str, Any] | NotMade:
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
