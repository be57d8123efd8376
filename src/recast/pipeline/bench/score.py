"""The rows of a scene whose rollouts are all made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from recast.core import Artefact
from recast.evaluation.grid_row import GridRow
from recast.evaluation.same_script import script_difference
from recast.pipeline.bench.scenes import BenchScene
from recast.pipeline.bench.tasks import Outcome
from recast.pipeline.config import RunConfig
from recast.pipeline.layout import rollout_name
from recast.pipeline.rollouts import read_rollout
from recast.simulation import Rollout

OTHER_SCRIPT = "OtherScript"
"""Error of a row whose actor, route or start is not that of the other arms."""


def blank_row(scene: BenchScene, config: RunConfig, motion: str, planner: str, arm: str) -> GridRow:
    """The row of a rollout of which nothing is known yet.

    Args:
        planner: its name in results.
    """
    found = config.motion(motion)
    return GridRow(
        scene=scene.id,
        world=scene.world,
        seed=scene.seed,
        motion=found.name,
        setting=found.setting,
        arm=arm,
        planner=planner,
    )


def scene_rows(
    scene: BenchScene,
    config: RunConfig,
    log: str,
    names: Mapping[str, str],
    metrics: Mapping[str, Any],
    used: Mapping[str, Artefact],
    errors: Mapping[str, Outcome],
) -> list[GridRow]:
    """The rows of a scene, by motion, then by planner, then by arm.

    Every arm must have been given the same route and start, and the same states of actors that do
    not react to the ego: a row that was not is a failure.

    Args:
        log: name of the log.
        names: planners' names in results, by the word that asks for them.
        metrics: of the scene's run, see `read_metrics`.
        used: artefacts by use.
        errors: of rollouts that could not begin, by use.
    """
    scored = {_key(one): one for one in metrics["rollouts"]}
    failures = {_key(one): one for one in metrics["failures"]}
    rows = []
    for motion in config.motions:
        first: Rollout | None = None
        for planner in config.planners:
            for arm in config.arms:
                row = blank_row(scene, config, motion, names[planner], arm.name)
                row = row.of_log(log, config.track)
                key = (row.motion, row.setting, row.planner, row.arm)
                use = rollout_name(motion, planner, arm.name)
                if use in errors:
                    error = errors[use]
                    rows.append(row.failed(error.error or "Error", error.reason or ""))
                    continue
                if key in failures:
                    rows.append(row.failed(failures[key]["error"], failures[key]["reason"]))
                    continue
                rollout = read_rollout(used[use].path)
                assert isinstance(rollout, Rollout)  # or else it is among the failures
                first = first or rollout
                differs = script_difference(first, rollout)
                if differs is None:
                    rows.append(row.scored(scored[key]))
                else:
                    rows.append(row.failed(OTHER_SCRIPT, f"{differs}, compared with {first.name}"))
    return rows


def _key(entry: Mapping[str, Any]) -> tuple[str, str, str, str]:
    return entry["motion"], entry["setting"], entry["planner"], entry["arm"]
