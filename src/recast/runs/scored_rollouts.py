"""The stored rollouts of a scenario under all arms, scored, with what else their trust reads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from recast.core import Artefact
from recast.logs import HdMap
from recast.metrics import RolloutMetrics, rollout_metrics
from recast.runs.arms import Arm, under_other_noise
from recast.runs.layout import rollout_name, use_name
from recast.runs.rollouts import read_coverage, read_rollout
from recast.simulation import Rollout, RolloutFailure
from recast.simulation.coverage import RolloutCoverage


@dataclass(frozen=True)
class ScoredRollout:
    """A stored rollout of an arm, scored, with what else its trust depends on.

    Attributes:
        folder: folder that `make_rollout` wrote.
        coverage: coverage of its vehicle; None for a vehicle without shares.
        evaluation: held-out scores of its street; None if no image was held out.
        disturbed: the same scenario, planner and arm under other noise.
    """

    arm: Arm
    folder: Path
    metrics: RolloutMetrics
    coverage: RolloutCoverage | None
    evaluation: Artefact | None
    disturbed: tuple[RolloutMetrics, ...]


def scored_rollouts(
    motion: str,
    planner: str,
    arms: Sequence[Arm],
    find: Callable[[str], Artefact | None],
    hd_map: HdMap,
) -> dict[str, ScoredRollout | RolloutFailure]:
    """The rollouts of a scenario that were made, by arm.

    Args:
        motion, planner: names of the motion and the planner in the run's config.
        find: function that gives the artefact of a use; None if the run has none.
        hd_map: lanes and drivable area that they are judged by.

    Raises:
        InputError: a record is missing or damaged.
    """
    made = {arm.name: find(rollout_name(motion, planner, arm.name)) for arm in arms}
    folders = {name: artefact.path for name, artefact in made.items() if artefact is not None}
    results = {name: read_rollout(folder) for name, folder in folders.items()}
    metrics = {
        name: rollout_metrics(result, hd_map)
        for name, result in results.items()
        if isinstance(result, Rollout)
    }
    found: dict[str, ScoredRollout | RolloutFailure] = {}
    for arm in arms:
        result = results.get(arm.name)
        if isinstance(result, RolloutFailure):
            found[arm.name] = result
        elif result is not None:
            disturbed = (one.name for one in under_other_noise(arm, arms))
            found[arm.name] = ScoredRollout(
                arm,
                folders[arm.name],
                metrics[arm.name],
                read_coverage(folders[arm.name]),
                find(use_name("evaluation", arm.street)),
                tuple(metrics[name] for name in disturbed if name in metrics),
            )
    return found
