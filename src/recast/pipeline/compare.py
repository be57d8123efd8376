"""Gather several runs for the page that sets them side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from recast.errors import InputError
from recast.pipeline.report import GatheredRun, open_run
from recast.pipeline.report_parts import headings
from recast.reporting import ComparedRun, write_comparison
from recast.reporting.page import check_out


def compare_runs(runs: Sequence[str | Path], out: str | Path) -> Path:
    """Write a page that compares runs, the others with the first; return its `index.html`.

    The runs may be of different logs, and unfinished.

    Args:
        runs: at least two run folders.
        out: folder of the page.

    Raises:
        InputError: fewer than two runs, a folder that is no run or is named twice, a log or an
            artefact that is gone, or `out` holds something else.
    """
    folders = [Path(run) for run in runs]
    if len(folders) < 2:
        raise InputError(
            "--compare", "runs", f"{len(folders)} given", "name two run folders or more"
        )
    places = [folder.resolve() for folder in folders]
    for folder, place in zip(folders, places, strict=True):
        if places.count(place) > 1:
            raise InputError(folder, "run", "is named twice", "name each run once")
    check_out(Path(out))
    opened = [open_run(folder) for folder in folders]
    names = _names(places)
    return write_comparison([_compared(*one) for one in zip(names, opened, strict=True)], out)


def _names(places: Sequence[Path]) -> list[str]:
    """Names of the folders, with as many of their parents as it takes to tell them apart."""
    for parts in range(1, max(len(place.parts) for place in places)):
        names = ["/".join(place.parts[-parts:]) for place in places]
        if len(set(names)) == len(names):
            return names
    return [str(place) for place in places]


def _compared(name: str, run: GatheredRun) -> ComparedRun:
    record, config = run.folder.record, run.config
    return ComparedRun(
        name=name,
        log=run.log.name,
        log_hash=record.log.hash,
        target=config.track,
        arms=run.arms,
        scenarios={
            (config.motion(motion).name, config.motion(motion).setting, planner): run.scenario(
                motion, planner
            )
            for motion in config.motions
            for planner in config.planners
        },
        settings={
            **config.resolved(),
            "log": {"name": run.log.name, "hash": record.log.hash},
            "versions": record.versions,
        },
        hd_map=run.map,
        camera_headings=headings(run.log),
    )
