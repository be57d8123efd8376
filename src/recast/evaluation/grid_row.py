"""One rollout of a grid as a row: what it was, what it scored, or why there is nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from recast.evaluation.metric import Metric, invalid
from recast.evaluation.table import COLUMNS


@dataclass(frozen=True)
class GridRow:
    """A rollout of a grid of scenes, motions, settings and arms.

    Attributes:
        scene: its id in the grid.
        world, seed: of a synthetic scene, else None.
        log: name of the log; None where there is none.
        track_id: the controlled actor; None where the scene failed before it was known.
        motion, setting, arm, planner: as in `Rollout`.
        start_timestamp_us, steps_requested, steps_run, cut_reason: as in `RolloutMetrics`; None
            where the rollout failed.
        plan_steps: steps at which plans were made; empty where the rollout failed.
        first_collision_step: None where there was no collision.
        map_derived: as in `RolloutMetrics`.
        scores: by metric, keys of `COLUMNS`, plain values (shares between 0 and 1, seconds); None
            where a metric is not valid. Empty where the rollout failed.
        shorter: the same scores of the first steps alone, by how many steps: for each length at
            which the rollout of another arm in the scenario was cut.
        failure: class of the error; None where the rollout was scored.
        failure_reason: its message.
    """

    scene: str
    world: str | None
    seed: int | None
    motion: str
    setting: str
    arm: str
    planner: str
    log: str | None = None
    track_id: str | None = None
    start_timestamp_us: int | None = None
    steps_requested: int | None = None
    steps_run: int | None = None
    cut_reason: str | None = None
    plan_steps: tuple[int, ...] = ()
    first_collision_step: int | None = None
    map_derived: bool | None = None
    scores: Mapping[str, float | None] = field(default_factory=dict)
    shorter: Mapping[int, Mapping[str, float | None]] = field(default_factory=dict)
    failure: str | None = None
    failure_reason: str | None = None

    def of_log(self, log: str, track_id: str) -> GridRow:
        """This row with the log and the track it was run on."""
        return replace(self, log=log, track_id=track_id)

    def scored(self, metrics: Mapping[str, Any]) -> GridRow:
        """This row with an entry of metrics.json, see `recast.pipeline.scores`."""
        per_step = metrics["per_step"]
        return replace(
            self,
            start_timestamp_us=metrics["start_timestamp_us"],
            steps_requested=metrics["steps_requested"],
            steps_run=metrics["steps_run"],
            cut_reason=metrics["cut_reason"],
            plan_steps=tuple(metrics["per_cycle"]["plan_steps"]),
            first_collision_step=per_step["first_collision_step"],
            map_derived=per_step["map_derived"],
            scores={name: metrics["metrics"][name]["value"] for name in COLUMNS},
            shorter={
                int(steps): {name: scores[name] for name in COLUMNS}
                for steps, scores in metrics["shorter"].items()
            },
        )

    def over(self, steps: int) -> GridRow:
        """This row, had the rollout ended after `steps`: its own length, or one of `shorter`."""
        if steps == self.steps_run:
            return self
        return replace(
            self, steps_run=steps, scores=self.shorter[steps], shorter={},
            plan_steps=tuple(step for step in self.plan_steps if step < steps),
        )  # fmt: skip

    def failed(self, error: str, reason: str) -> GridRow:
        """This row without scores, and why."""
        return replace(
            self, start_timestamp_us=None, steps_run=None, cut_reason=None, plan_steps=(),
            first_collision_step=None, map_derived=None, scores={}, shorter={}, failure=error,
            failure_reason=reason,
        )  # fmt: skip

    @property
    def plans(self) -> int:
        """How many plans were made."""
        return len(self.plan_steps)

    @property
    def values(self) -> Mapping[str, Metric]:
        """Every metric by name."""
        found = {name: self.scores.get(name) for name in COLUMNS}
        return {n: invalid("no value") if v is None else Metric(v) for n, v in found.items()}

    @property
    def collided(self) -> bool | None:
        """The verdict; None where the rollout failed."""
        nc = self.scores.get("nc")
        return None if nc is None else nc == 0.0

    @property
    def scenario(self) -> tuple[str, str, str, str]:
        """What rollouts have in common that differ in the arm only."""
        return self.scene, self.motion, self.setting, self.planner
