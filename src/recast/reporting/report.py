"""A run as one self-contained folder: `index.html` with its pictures and films."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from recast import __version__
from recast.errors import InputError
from recast.reporting import palette, summary, tables
from recast.reporting.assets import Assets
from recast.reporting.checks import checks
from recast.reporting.coverage_view import coverage_lines, coverage_note
from recast.reporting.inputs import (
    NOT_MADE,
    ActorPart,
    NotMade,
    ObservationPart,
    ReportInputs,
    ScenePart,
)
from recast.reporting.scenario_view import ScenarioView, scenario_view
from recast.reporting.truth import truth_view
from recast.reporting.truth_inputs import ShowcasePart, TruthPart
from recast.storage import atomic_folder, disk_errors, write_text

_GENERATOR = "recast report"


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
    out = Path(out)
    if out.exists() and not _is_report(out):
        raise InputError(
            out, "report folder", "holds something that is no report", "name another folder"
        )
    fresh = out.with_name(f".{out.name}.fresh")
    with disk_errors(out):
        if fresh.exists():  # left behind by a kill
            shutil.rmtree(fresh)
    with atomic_folder(fresh) as folder:
        write_text(folder / "index.html", _render(run, Assets(folder)))
    with disk_errors(out):
        if out.exists():
            shutil.rmtree(out)
        fresh.rename(out)
    return out / "index.html"


def _is_report(folder: Path) -> bool:
    page = folder / "index.html"
    if not page.is_file():
        return folder.is_dir() and not any(folder.iterdir())
    return f'content="{_GENERATOR}' in page.read_text(encoding="utf-8", errors="replace")[:2000]


def _render(run: ReportInputs, assets: Assets) -> str:
    environment = Environment(
        loader=PackageLoader("recast.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.tests["missing"] = lambda value: isinstance(value, NotMade)
    environment.globals["share_colours"] = {
        name: palette.css(colour) for name, colour in palette.SHARES.items()
    }
    environment.filters["arm_colour"] = lambda i: palette.css(palette.arm_colour(i))
    environment.filters["coverage_note"] = coverage_note
    environment.globals["zip"] = zip
    loader = environment.loader
    assert loader is not None

    def inline(name: str) -> Markup:
        return Markup(loader.get_source(environment, name)[0])

    scenarios: tuple[ScenarioView, ...] | NotMade
    if isinstance(run.scenarios, NotMade):
        scenarios = run.scenarios
        aggregate: tuple[tables.Line, ...] = ()
    else:
        scenarios = tuple(
            scenario_view(run, part, f"scenario-{i + 1}", assets)
            for i, part in enumerate(run.scenarios)
        )
        aggregate = tables.aggregate_lines(run.scenarios, run.arms, run.truth_arm)
    return environment.get_template("report.html").render(
        run=run,
        generator=f"{_GENERATOR} {__version__}",
        style=inline("report.css"),
        script=inline("report.js"),
        headline=summary.headline(run),
        checks=checks(run),
        outcomes=summary.outcomes(run),
        headings=tables.headings(),
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
        markup=Markup,
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
        "frame": assets.picture("actor-frame", seen.frame),
        "facts": seen.facts,
        "turntable": assets.film("actor-turntable", actor.turntable),
        "all_around": assets.picture("actor-all-around", actor.all_around),
        "registration": actor.registration,
    }


def _scene(scene: ScenePart | NotMade, assets: Assets) -> dict[str, Any] | NotMade:
    if isinstance(scene, NotMade):
        return scene
    comparisons = [
        (
            comparison.caption,
            [
                (label, assets.picture(f"scene-{i + 1}-{label}", picture))
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
