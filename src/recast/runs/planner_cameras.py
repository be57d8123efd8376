"""The cameras that a run renders for its planners, and what it says of them beforehand."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Console

from recast.cameras import CameraMount
from recast.core.errors import InputError
from recast.logs import DrivingLog
from recast.planning import Planner, seen_lines, shown_views, virtual_mounts
from recast.runs.config import RunConfig
from recast.simulation import camera_mounts


def run_mounts(log: DrivingLog, planner: Planner, config: RunConfig) -> dict[str, CameraMount]:
    """The cameras that a run renders: the log's, at the scale of the scene, and `planner_mounts`.

    Raises:
        InputError: the configuration names a camera that the log lacks, or see `planner_mounts`.
    """
    mounts = camera_mounts(log, config.scene.cameras or None, config.scene.scale)
    return planner_mounts(mounts, planner, config)


def planner_mounts(
    mounts: Mapping[str, CameraMount], planner: Planner, config: RunConfig
) -> dict[str, CameraMount]:
    """The log's cameras, and virtual ones that the planner wants.

    nuPlan's have the scale of the scene, too: 1920x1080 at scale 1. InputError: see `shown_views`.
    """
    rendered = {**mounts, **virtual_mounts(planner, mounts, config.scene.scale)}
    shown_views(planner, rendered)
    return rendered


def require_distinct_planners(planners: Mapping[str, Planner]) -> None:
    """Refuse planners, by the word that asks for each, that results could not tell apart.

    Raises:
        InputError: two have the same name.
    """
    named: dict[str, str] = {}
    for word, planner in planners.items():
        other = named.setdefault(planner.name, word)
        if other != word:
            raise InputError(
                "`planner`",
                word,
                f"has the same name as {other}: {planner.name}",
                "give the planners different names",
            )


def announce_planner(
    planner: Planner, mounts: Mapping[str, CameraMount], console: Console, where: str = ""
) -> None:
    """Print, after `where` on each line, on which device the planner computes and what it sees."""
    said, warning = seen_lines(planner, mounts)
    if said:
        console.print(f"{where}{said}", markup=False, highlight=False)
    if warning:
        console.print(f"{where}warning: {warning}", markup=False, highlight=False, style="yellow")
