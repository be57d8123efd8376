"""Several runs on one page: what they were asked, what they scored, where each one's arms part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from recast.logs.hdmap import HdMap
from recast.reporting.assets import Assets
from recast.reporting.birdseye import Birdseye
from recast.reporting.compare_inputs import ComparedRun, letter
from recast.reporting.compare_metrics import metric_lines, outcome_rows
from recast.reporting.compare_settings import differing_settings
from recast.reporting.drives_compared import listed
from recast.reporting.inputs import ReportInputs, ScenarioPart
from recast.reporting.map_layer import MapLayer
from recast.reporting.moment_strip import Strip, moment_strip
from recast.reporting.page import render_template, write_page
from recast.simulation.rollout import Rollout


@dataclass(frozen=True)
class RunMoments:
    """The moments of one scenario in one run."""

    run: str
    title: str
    strip: Strip


def write_comparison(runs: Sequence[ComparedRun], out: str | Path) -> Path:
    """Write a page that compares runs, the others with the first; return its `index.html`.

    The folder appears whole and asks for nothing from the network. The same runs give the same
    bytes.

    Args:
        runs: at least two.
        out: folder of the page.

    Raises:
        InputError: `out` holds something that is no report, or the disk is full.
        ValueError: fewer than two runs.
    """
    if len(runs) < 2:
        raise ValueError(f"runs: {len(runs)} given, at least two are compared")
    return write_page(out, lambda assets: _render(runs, assets))


def _render(runs: Sequence[ComparedRun], assets: Assets) -> str:
    titles = list({arm: title for run in reversed(runs) for arm, title in run.arms.items()}.items())
    order = list(dict.fromkeys(arm for run in runs for arm in run.arms))
    arms = {arm: dict(titles)[arm] for arm in order}
    return render_template(
        "compare.html",
        runs=[(letter(number), run) for number, run in enumerate(runs)],
        warnings=_warnings(runs),
        settings=differing_settings(runs),
        metrics=metric_lines(runs),
        outcomes=outcome_rows(runs),
        moments=[
            RunMoments(letter(number), part.title, _strip(run, arms, letter(number), part, assets))
            for number, run in enumerate(runs)
            for part in run.scenarios.values()
        ],
        arms=list(arms.values()),
    )


def _warnings(runs: Sequence[ComparedRun]) -> tuple[str, ...]:
    """In which way the runs are not comparable, in sentences."""
    found = []
    first = runs[0]
    for number, run in enumerate(runs[1:], 1):
        if run.log_hash != first.log_hash:
            found.append(
                f"{letter(number)} is a run on another log than A ({run.log}, not {first.log}): "
                "its differences are between different scenes."
            )
        elif run.target != first.target:
            found.append(f"{letter(number)} has the target {run.target}, A has {first.target}.")
    missing = {
        letter(number): [
            f"{motion}, setting {setting}, {planner}"
            for motion, setting, planner in first.scenarios
            if (motion, setting, planner) not in run.scenarios
        ]
        for number, run in enumerate(runs[1:], 1)
    }
    found += [f"{name} does not have {listed(keys)}." for name, keys in missing.items() if keys]
    return tuple(found)


def _strip(
    run: ComparedRun, arms: dict[str, str], name: str, part: ScenarioPart, assets: Assets
) -> Strip:
    inputs = ReportInputs(run.name, run.log, arms, camera_headings=run.camera_headings)
    layer = MapLayer(run.hd_map if isinstance(run.hd_map, HdMap) else None)
    drawn = {
        one.arm: Birdseye(one.rollout, layer)
        for one in part.rollouts
        if isinstance(one.rollout, Rollout)
    }
    return moment_strip(inputs, f"{name}-{part.title}", part.rollouts, drawn, assets)
